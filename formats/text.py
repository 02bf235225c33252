"""Text files of numbers."""

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError


def lines_of(path: Path) -> list[str]:
    """The lines of a file, without blanks around them.

    Raises:
        FormatError: it is missing or no text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read: {error}") from error
    return [line.strip() for line in text.removesuffix("\n").split("\n")]


def numbers_of(path: Path, text: str) -> Floats:
    """(N,) the numbers in a text of a file, with blanks between them.

    Raises:
        FormatError: it holds something else, or what is not finite.
    """
    try:
        numbers = np.array(text.split(), np.float64)
    except ValueError as error:
        raise FormatError(f"{path} cannot be read: {error}") from error
    if not np.isfinite(numbers).all():
        raise FormatError(f"{path} holds numbers that are not finite")
    return numbers


def shortest(value: float) -> str:
    """The shortest text that is read as the same number."""
    return repr(float(value))


def joined(values: Floats) -> str:
    """All numbers of an array, with blanks between them."""
    return " ".join(map(shortest, np.ravel(values).tolist()))


def seconds_of(stamp_ns: int) -> str:
    """A time, ns, as seconds with all its digits; it goes through no float."""
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def nanoseconds(path: Path, seconds: str) -> int:
    """A time of a file, s, in ns; it goes through no float.

    Raises:
        FormatError: it is none.
    """
    try:
        found = int((Decimal(seconds) * 10**9).to_integral_value())
    except (InvalidOperation, ValueError, OverflowError) as error:
        raise FormatError(f"{path}: '{seconds[:40]}' is no time in seconds") from error
    if abs(found) >= 2**63:
        raise FormatError(f"{path}: {seconds[:40]} s is later than any clock shows")
    return found
