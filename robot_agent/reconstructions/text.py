"""Text files of numbers."""

from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.model import Floats


def lines_of(path: Path) -> list[str]:
    """The lines of a file, without blanks around them.

    Raises:
        DataFolderError: it is missing or no text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} cannot be read: {error}") from error
    return [line.strip() for line in text.removesuffix("\n").split("\n")]


def numbers_of(path: Path, text: str) -> Floats:
    """(N,) the numbers in a text of a file, with blanks between them.

    Raises:
        DataFolderError: it holds something else, or what is not finite.
    """
    try:
        numbers = np.array(text.split(), np.float64)
    except ValueError as error:
        raise DataFolderError(f"{path} cannot be read: {error}") from error
    if not np.isfinite(numbers).all():
        raise DataFolderError(f"{path} holds numbers that are not finite")
    return numbers
