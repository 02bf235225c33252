"""What goes wrong when a fleet is put into the field; each is a sentence that says what to do."""

from fleetpose.protocol.errors import FleetPoseError


class SiteError(FleetPoseError):
    """A site's folder is missing, or says what cannot be."""


class BundleError(FleetPoseError):
    """A bundle that cannot be read, or does not belong where it is to be installed."""
