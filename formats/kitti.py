"""Trajectories as KITTI's odometry benchmark writes them (Geiger et al. 2012): a line for each
pose, the upper three rows of the matrix row by row; times in a file beside it, one a line, seconds.
"""

from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices
from fleetpose.formats.rotations import is_rotation
from fleetpose.formats.text import joined, lines_of, nanoseconds, numbers_of, seconds_of

_NUMBERS = 12


def write_kitti(path: Path, poses: Floats) -> None:
    """Writes poses (N, 4, 4).

    Raises:
        OSError: it cannot be written.
    """
    path.write_text("".join(f"{joined(T[:3])}\n" for T in poses))


def read_kitti(path: Path) -> Floats:
    """Poses (N, 4, 4).

    Raises:
        FormatError: it cannot be read, or a line is no pose; the text names it.
    """
    poses = []
    for number, line in enumerate(lines_of(path), 1):
        if not line:
            continue
        values = numbers_of(path, line)
        T = np.eye(4)
        if len(values) == _NUMBERS:
            T[:3] = values.reshape(3, 4)
        if len(values) != _NUMBERS or not is_rotation(T[:3, :3]):
            raise FormatError(f"{path}, line {number}: no pose, which is {_NUMBERS} numbers")
        poses.append(T)
    return np.array(poses).reshape(-1, 4, 4)


def write_times(path: Path, stamps_ns: Indices) -> None:
    """Writes times (N,), ns, as seconds with all their digits.

    Raises:
        OSError: it cannot be written.
    """
    path.write_text("".join(f"{seconds_of(stamp_ns)}\n" for stamp_ns in stamps_ns.tolist()))


def read_times(path: Path) -> Indices:
    """(N,) times in ns.

    Raises:
        FormatError: it cannot be read, or holds what is no time.
    """
    words = " ".join(lines_of(path)).split()
    return np.array([nanoseconds(path, word) for word in words], np.int64)
