"""What geometry raises when the input determines nothing; callers turn it into a rejection with its
reason.
"""


class DegenerateGeometryError(ValueError):
    """The points given do not determine what was asked; the text names the numbers."""


class MissingLibraryError(RuntimeError):
    """A library that was asked for cannot be loaded; the text says what to install."""
