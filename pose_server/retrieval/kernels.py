"""The inner loop of the index, compiled by numba: a million words are compared in milliseconds."""

import numpy as np
import numpy.typing as npt
from numba import njit

_PAIRS, _FOURS, _BYTES, _SUM = (
    np.uint64(word)
    for word in (
        0x5555555555555555,
        0x3333333333333333,
        0x0F0F0F0F0F0F0F0F,
        0x0101010101010101,
    )
)
_1, _2, _4, _56 = (np.uint64(shift) for shift in (1, 2, 4, 56))


@njit("i8(u8)", cache=True, inline="always")
def _bits(word: np.uint64) -> np.int64:
    """How many bits are set."""
    word = word - ((word >> _1) & _PAIRS)
    word = (word & _FOURS) + ((word >> _2) & _FOURS)
    word = (word + (word >> _4)) & _BYTES
    return np.int64((word * _SUM) >> _56)


@njit("f4[::1](u8[:, ::1], i4[:, ::1], i8[::1], i8[::1], u8[::1], i8, i8)", cache=True)
def count_votes(
    signatures: npt.NDArray[np.uint64],
    owners: npt.NDArray[np.int32],
    added: npt.NDArray[np.int64],
    cells: npt.NDArray[np.int64],
    asked: npt.NDArray[np.uint64],
    count: int,
    reach: int,
) -> npt.NDArray[np.float32]:
    """(count,) votes for owners.

    Args:
        signatures: (cells, room) 64 bits of each descriptor.
        owners: (cells, room) whose it is; negative: nobody's.
        added: (cells,) how many were ever put there; the first places are full of them.
        cells: (N,) where the descriptors that vote lie.
        asked: (N,) their bits.
        count: of owners.
        reach: bits that may differ.
    """
    room = signatures.shape[1]
    votes = np.zeros(count, np.float32)
    near = np.empty(room, np.int32)
    weights = np.empty(room, np.float32)
    for n in range(len(asked)):
        cell, found = cells[n], 0
        for k in range(min(added[cell], room)):
            owner = owners[cell, k]
            if owner >= 0:
                differ = _bits(signatures[cell, k] ^ asked[n])
                if differ <= reach:
                    near[found] = owner
                    weights[found] = (reach + 1 - differ) ** 2
                    found += 1
        for k in range(found):
            votes[near[k]] += weights[k] / np.sqrt(found)
    return votes
