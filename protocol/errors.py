"""The one root of the errors that a process survives; anything else is a bug and ends the
process.
"""


class FleetPoseError(Exception):
    """Root of all errors of the project that are caught, counted and reported at the shell of a
    process.
    """


class CodecError(FleetPoseError):
    """Bytes that are no valid message: malformed, oversize, of another version, or of wrong
    shape.
    """


class NameRefusedError(FleetPoseError):
    """A key, robot, site or operator name that does not follow the rules of `protocol.keys`."""


class UnreachableError(FleetPoseError):
    """No router, robot or server answered where one was expected."""


class EndedError(FleetPoseError):
    """The process was asked to end while it waited."""


class NameTakenError(FleetPoseError):
    """Another live process has the name."""


class EndpointError(FleetPoseError):
    """An endpoint, or a configuration of the network, that cannot be used as it is written."""


class CalibrationError(FleetPoseError):
    """A camera's calibration is missing or impossible; the sentence says what to fix."""


class DataFolderError(FleetPoseError):
    """A recording's folder lacks a file or holds one that cannot be read; the sentence names it."""
