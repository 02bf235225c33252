"""Which bags there are below a place."""

from collections.abc import Sequence
from pathlib import Path

from fleetpose.protocol.errors import DataFolderError
from fleetpose.rosmsg import METADATA, SUFFIXES


def found(data: Sequence[Path]) -> list[Path]:
    """The bags that are named, and those below folders that are none.

    Raises:
        DataFolderError: there are none.
    """
    bags: list[Path] = []
    for place in data:
        below = sorted(_below(place))
        if not below:
            raise DataFolderError(f"{place}: no bag there (.mcap, .db3, .bag, a recorder's folder)")
        bags += below
    return bags


def _below(place: Path) -> list[Path]:
    if place.is_file() or (place / METADATA).is_file():
        return [place]
    if not place.is_dir():
        return []
    inner = [bag for one in place.iterdir() if one.is_dir() for bag in _below(one)]
    return inner + [one for one in place.iterdir() if one.suffix in SUFFIXES]
