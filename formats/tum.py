"""Trajectories as the TUM RGB-D benchmark writes them (Sturm et al. 2012), which evo and most
others read: a line for each pose, `time tx ty tz qx qy qz qw`, seconds and metres.

A pose maps what moves (body or camera) to the world. Times are kept to the nanosecond: as decimals
they go through no float.
"""

from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices
from fleetpose.formats.rotations import pose_of, quat_wxyz
from fleetpose.formats.text import lines_of, nanoseconds, numbers_of, seconds_of, shortest

_NUMBERS = 7  # beside the time


def tum_line(stamp_ns: int, T: Floats) -> str:
    """The line of a pose (4, 4)."""
    w, x, y, z = quat_wxyz(T[:3, :3])
    numbers = " ".join(map(shortest, (*T[:3, 3], x, y, z, w)))
    return f"{seconds_of(stamp_ns)} {numbers}"


def write_tum(path: Path, stamps_ns: Indices, poses: Floats) -> None:
    """Writes poses (N, 4, 4) with their times (N,), in the order given.

    Raises:
        OSError: it cannot be written.
    """
    rows = zip(stamps_ns.tolist(), poses, strict=True)
    path.write_text("".join(f"{tum_line(stamp_ns, T)}\n" for stamp_ns, T in rows))


def read_tum(path: Path) -> tuple[Indices, Floats]:
    """Times (N,), ns, and poses (N, 4, 4); lines with # are remarks, commas are blanks.

    Raises:
        FormatError: it cannot be read, or a line is no pose; the text names it.
    """
    stamps_ns, poses = [], []
    for number, line in enumerate(lines_of(path), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        values = numbers_of(path, " ".join(words[1 : _NUMBERS + 1]))
        if len(values) != _NUMBERS or not values[3:].any():
            raise FormatError(f"{path}, line {number}: no pose, which is time tx ty tz qx qy qz qw")
        stamps_ns.append(nanoseconds(path, words[0]))
        poses.append(pose_of(values[[6, 3, 4, 5]], values[:3]))
    return np.array(stamps_ns, np.int64), np.array(poses).reshape(-1, 4, 4)
