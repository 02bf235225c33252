"""What an operator can do wrong; each sentence says what to do instead."""

from fleetpose.protocol.errors import FleetPoseError, UnreachableError


class OperatorError(FleetPoseError):
    """A command that cannot be carried out as given."""


class NoServerError(UnreachableError):
    """No pose server was heard in time."""


class PictureError(FleetPoseError):
    """An image that cannot be shown; the sentence goes on after 'the image cannot be read: '."""
