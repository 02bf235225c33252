"""RVL, a lossless code of depth images of 16 bits (Wilson, ISS 2017): runs of zeros and of others,
and of the others the differences, as nibbles of three bits with a sign that more follow.
"""

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError

_LARGEST = 4096  # pixels of a side


def decoded(data: bytes, width: int, height: int) -> npt.NDArray[np.uint16]:
    """(height, width) uint16.

    Raises:
        CodecError: the bytes end before the image does, or say what cannot be.
    """
    if not (0 < width <= _LARGEST and 0 < height <= _LARGEST):
        raise CodecError(f"an RVL image of {width}x{height}")
    numbers = _numbers(data).tolist()
    size, filled, at = width * height, 0, 0
    differences = np.zeros(size, np.int64)
    valid = np.zeros(size, np.bool_)
    # a run of zeros, a run of others, and of these the differences: the runs alone need a loop
    parsed = np.array(numbers, np.int64)
    while filled < size:
        if at + 1 >= len(numbers):
            raise CodecError(f"an RVL image ends after {filled} of {size} pixels")
        zeros, others = numbers[at], numbers[at + 1]
        begin, end = filled + zeros, filled + zeros + others
        if end > size or at + 2 + others > len(numbers) or not zeros + others:
            raise CodecError(f"an RVL image with a run to pixel {end} of {size}")
        differences[begin:end] = parsed[at + 2 : at + 2 + others]
        valid[begin:end] = True
        filled, at = end, at + 2 + others
    signed = (differences >> 1) ^ -(differences & 1)
    values = np.cumsum(signed)
    return np.where(valid, values, 0).astype(np.uint16).reshape(height, width)


def _numbers(data: bytes) -> npt.NDArray[np.int64]:
    """All numbers of a stream: nibbles, three bits each, the lowest first; the fourth bit of all
    but a number's last nibble is set. Words of 32 bits hold eight, the first one highest.
    """
    words = np.frombuffer(data[: len(data) // 4 * 4], "<u4")
    shifts = np.arange(28, -4, -4, dtype=np.uint32)
    nibbles = ((words[:, None] >> shifts) & 15).astype(np.int64).reshape(-1)
    ends = np.flatnonzero(nibbles < 8)
    if not ends.size:
        return np.zeros(0, np.int64)
    begins = np.concatenate(([0], ends[:-1] + 1))
    places = np.arange(ends[-1] + 1) - np.repeat(begins, ends - begins + 1)
    if places.max() > 10:
        raise CodecError("an RVL image with a number of more than 32 bits")
    parts = (nibbles[: ends[-1] + 1] & 7) << (3 * places)
    return np.add.reduceat(parts, begins)
