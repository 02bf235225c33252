"""Descriptors of many owners by cells of their space, each shortened to 64 bits within its cell;
a set of descriptors votes for the owners of those that are near.

After Jegou, Douze, Schmid: Hamming embedding and weak geometric consistency for large scale image
search (ECCV 2008), and On the burstiness of visual elements (CVPR 2009). A descriptor of which many
are near says little: its votes are divided by the root of their number.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.retrieval.kernels import count_votes
from fleetpose.pose_server.tuned import in_use

Descriptors = npt.NDArray[np.float32]
_BITS = 64  # an order of numpy and numba: one word
_ROUNDS = 3  # numerical: of Lloyd's algorithm; two more found no more neighbours
NOBODY = -1


@dataclass(frozen=True)
class IndexSettings:
    """What the index goes by; set on church, temple, house, portal, kitchen and seven fooling
    plans.
    """

    cells: int = 1024
    reach: int = 22  # bits that may differ
    room: int = 4096  # descriptors a cell keeps, the newest; bounds memory and time
    taught_by: int = 4096  # descriptors that cells are made of


INDEX = in_use("index", IndexSettings())


class HammingIndex:
    """An index whose cells are made of the first descriptors it is told of.

    Args:
        taught: (N, D) unit descriptors, at least as many as there are cells.
    """

    def __init__(self, taught: Descriptors) -> None:
        self._centres = _lloyd(taught, INDEX.cells)
        self._half_squares = 0.5 * (self._centres**2).sum(axis=1)
        axes = np.random.default_rng(0).normal(size=(taught.shape[1], _BITS))
        if len(axes) >= _BITS:
            axes = np.linalg.qr(axes)[0]
        self._axes = axes.astype(np.float32)
        self._thresholds = self._centres @ self._axes
        self._signatures = np.zeros((INDEX.cells, INDEX.room), np.uint64)
        self._owners = np.zeros((INDEX.cells, INDEX.room), np.int32)
        self._added = np.zeros(INDEX.cells, np.int64)

    def add(self, descriptors: Descriptors, owner: int) -> None:
        """Adds an owner's unit descriptors (N, D); full cells forget their oldest."""
        cells, signatures = self._shortened(descriptors)
        order = np.argsort(cells, kind="stable")
        cells, signatures = cells[order], signatures[order]
        nth = np.arange(len(cells)) - np.searchsorted(cells, cells)
        places = (self._added[cells] + nth) % INDEX.room
        self._signatures[cells, places] = signatures
        self._owners[cells, places] = owner
        self._added += np.bincount(cells, minlength=INDEX.cells)

    def votes(self, descriptors: Descriptors, owners: int) -> npt.NDArray[np.float32]:
        """(owners,) how much those numbered below have that looks like unit descriptors (N, D)."""
        cells, signatures = self._shortened(descriptors)
        return count_votes(
            self._signatures, self._owners, self._added, cells, signatures, owners, INDEX.reach
        )

    def renumber(self, numbers: npt.NDArray[np.int32]) -> None:
        """Gives owner n the number `numbers[n]`, or `NOBODY`."""
        self._owners = np.where(self._owners < 0, NOBODY, numbers[self._owners])

    def _shortened(
        self, descriptors: Descriptors
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.uint64]]:
        """(N,) cells, and (N,) on which side of the cell's centre they lie along 64 axes."""
        cells = (descriptors @ self._centres.T - self._half_squares).argmax(axis=1)
        sides = descriptors @ self._axes > self._thresholds[cells]
        return cells, np.packbits(sides, axis=1).view(np.uint64)[:, 0]


def _lloyd(descriptors: Descriptors, count: int) -> Descriptors:
    """(count, D) centres of the cells of descriptors (N, D), N >= count."""
    centres = descriptors[:: len(descriptors) // count][:count].copy()
    for _ in range(_ROUNDS):
        nearest = (descriptors @ centres.T - 0.5 * (centres**2).sum(axis=1)).argmax(axis=1)
        sums = np.zeros_like(centres)
        np.add.at(sums, nearest, descriptors)
        members = np.bincount(nearest, minlength=count)[:, None]
        centres = np.where(members > 0, sums / np.maximum(members, 1), centres).astype(np.float32)
    return centres
