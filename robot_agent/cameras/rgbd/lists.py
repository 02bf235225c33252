"""Lists of times and files, as TUM's RGB-D recordings and what followed them have."""

import bisect
from collections.abc import Iterator
from pathlib import Path

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.folders.files import text_of

MAX_DIFFERENCE_S = 0.02  # TUM's own tool allows it


def associated(folder: Path) -> list[tuple[Path, Path]]:
    """Colour and depth of `rgb.txt` and `depth.txt`: each depth image with the colour image
    nearest in time, if that is near enough.

    Raises:
        DataFolderError: a list cannot be read, or none are near enough.
    """
    colours, depths = _times(folder / "rgb.txt"), _times(folder / "depth.txt")
    times = [stamp_s for stamp_s, _ in colours]
    found = []
    for stamp_s, depth in depths:
        k = bisect.bisect_left(times, stamp_s)
        near = min(colours[max(k - 1, 0) : k + 1], key=lambda c: abs(c[0] - stamp_s), default=None)
        if near is not None and abs(near[0] - stamp_s) <= MAX_DIFFERENCE_S:
            found.append((near[1], depth))
    if not found and colours and depths:
        apart_s = min(abs(c[0] - d[0]) for c in colours[:50] for d in depths[:50])
        raise DataFolderError(
            f"{folder}: no image of rgb.txt was taken within {1e3 * MAX_DIFFERENCE_S:g} ms of "
            f"one of depth.txt; the nearest are {1e3 * apart_s:.0f} ms apart: bring both lists to "
            "one clock"
        )
    return found


def paired_already(path: Path) -> list[tuple[Path, Path]]:
    """Colour and depth of a list that has both in each line, in either order: time, file, time,
    file.

    Raises:
        DataFolderError: a line has not.
    """
    found = []
    for number, words in _rows(path):
        files = [path.parent / word for word in words[1::2]]
        depths = [file for file in files if "depth" in str(file.relative_to(path.parent)).lower()]
        if len(files) != 2 or len(depths) != 1:
            raise DataFolderError(
                f"{path}, line {number}: not the times and files of one colour and one depth image"
            )
        depth = depths[0]
        found.append((files[1 - files.index(depth)], depth))
    return found


def _times(path: Path) -> list[tuple[float, Path]]:
    rows = []
    for number, words in _rows(path):
        if not rows and words[0][:1].isalpha():
            continue  # a header without its mark
        try:
            rows.append((_seconds(words[0]), path.parent / words[1]))
        except (ValueError, IndexError) as error:
            raise DataFolderError(
                f"{path}, line {number}: '{' '.join(words)[:60]}' is no time with a file"
            ) from error
    return sorted(rows)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The words of each line, with its number; lines that begin with # are left out."""
    try:
        lines = text_of(path).splitlines()
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        if words := line.partition("#")[0].replace(",", " ").replace(";", " ").split():
            yield number, words


def _seconds(stamp: str) -> float:
    """A time as s; without a decimal point and longer than any since 1970, it is ns, us or ms."""
    value = float(stamp)
    digits = len(stamp.lstrip("+-"))
    if not stamp.isdigit() or digits <= 10:
        return value
    return value * 10.0 ** -(digits - 10)
