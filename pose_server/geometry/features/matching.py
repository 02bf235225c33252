"""Which salient point of one view is which of the other: by descriptor alone, and around a
predicted place.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features.kernels import best_around, first_of_each
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Descriptors = npt.NDArray[np.float32]
NO_MATCHES: Indices = np.zeros((0, 2), np.int64)
_BLOCK = 256  # numerical: rows of similarities that stay in the cache


@dataclass(frozen=True)
class MatchingSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    cell_px: float = 16.0  # width of a cell of the grid in which predicted places are searched, px
    same_place_px: float = 3.0  # candidates nearer to each other are no rivals


MATCHING = in_use("matching", MatchingSettings())


@dataclass(frozen=True)
class Prediction:
    """Where points of one view should appear in another.

    Attributes:
        index: (M,) which points of the source view.
        uv: (M, 2) their pixels in the target view.
        inverse_depth: (M,) their inverse depth there, 1/m.
    """

    index: Indices
    uv: Floats
    inverse_depth: Floats


@dataclass(frozen=True)
class PixelGrid:
    """Pixels (N, 2) by square cells: those of cell c are `order[begin[c] : begin[c + 1]]`.

    Attributes:
        uv: the pixels.
        begin: (rows * columns + 1,).
        order: (N,).
        columns: cells in a row.
    """

    uv: Floats
    begin: Indices
    order: Indices
    columns: int

    @classmethod
    def of(cls, uv: Floats) -> "PixelGrid":
        """The grid of pixels (N, 2), which are not below 0."""
        cell = np.maximum(uv // MATCHING.cell_px, 0).astype(np.int64)
        columns, rows = cell.max(axis=0, initial=0) + 1
        flat = cell[:, 1] * columns + cell[:, 0]
        begin = np.zeros(rows * columns + 1, np.int64)
        np.cumsum(np.bincount(flat, minlength=rows * columns), out=begin[1:])
        return cls(np.ascontiguousarray(uv), begin, np.argsort(flat, kind="stable"), int(columns))


def ratio_matches(
    descriptors_i: Descriptors, descriptors_j: Descriptors, ratio: float
) -> tuple[Indices, Floats]:
    """Mutual nearest neighbours that are clearly nearer than the second (Lowe 2004).

    Similarities are computed in blocks that fit into the cache and are never stored: writing them
    all to memory takes longer than computing them.

    Args:
        descriptors_i, descriptors_j: (N, D) of unit length.
        ratio: largest allowed distance ratio of nearest and second nearest.

    Returns:
        matches (M, 2), none if the descriptors are of different kinds, and their cosines (M,).
    """
    count_i, count_j = len(descriptors_i), len(descriptors_j)
    if min(count_i, count_j) < 3 or descriptors_i.shape[1] != descriptors_j.shape[1]:
        return NO_MATCHES, np.zeros(0)
    best = np.zeros(count_i, np.int64)
    first = np.zeros(count_i, np.float32)
    second = np.zeros(count_i, np.float32)
    best_of_j = np.full(count_j, -np.inf, np.float32)
    transposed = descriptors_j.T
    for start in range(0, count_i, _BLOCK):
        rows = slice(start, start + _BLOCK)
        cosines = descriptors_i[rows] @ transposed
        np.maximum(best_of_j, cosines.max(axis=0), out=best_of_j)
        best[rows] = cosines.argmax(axis=1)
        here = np.arange(len(cosines)), best[rows]
        first[rows] = cosines[here]
        cosines[here] = -np.inf
        second[rows] = cosines.max(axis=1)
    clear = (1 - np.minimum(first, 1)) < ratio**2 * (1 - second)
    kept = np.flatnonzero(clear & (first == best_of_j[best]))
    kept = kept[np.sort(np.unique(best[kept], return_index=True)[1])]  # twins tie
    return np.column_stack((kept, best[kept])), first[kept].astype(np.float64)


def guided_matches(
    prediction: Prediction,
    descriptors: Descriptors,
    grid: PixelGrid,
    inverse_depth: Floats,
    descriptors_there: Descriptors,
    radius_px: float,
    depth_tolerance: float,
    min_cosine: float = 0.85,
    ratio: float = 0.9,
) -> tuple[Indices, Floats]:
    """The best descriptor within a radius of the predicted place, and clearly better than others
    there.

    Args:
        prediction: places in the target view.
        descriptors: (M', D) of the source view's points.
        grid: of the target view's pixels (N, 2).
        inverse_depth: (N,) of the target's points, nan where unknown.
        descriptors_there: (N, D) of the target's points.
        radius_px: search radius.
        depth_tolerance: largest allowed relative difference of inverse depth, where it is known.
        min_cosine: smallest allowed similarity.
        ratio: largest allowed distance ratio to the best rival more than 3 px away.

    Returns:
        matches (M, 2) of source and target indices, and their cosines (M,).
    """
    comparable = descriptors.shape[1] == descriptors_there.shape[1]
    if len(prediction.index) == 0 or len(grid.uv) < 2 or not comparable:
        return NO_MATCHES, np.zeros(0)
    best, first, second = best_around(
        prediction.uv,
        prediction.inverse_depth,
        prediction.index,
        descriptors,
        grid.begin,
        grid.order,
        grid.columns,
        MATCHING.cell_px,
        grid.uv,
        inverse_depth,
        descriptors_there,
        radius_px,
        depth_tolerance,
        MATCHING.same_place_px,
    )
    keep = (first > min_cosine) & ((1 - first) < ratio**2 * (1 - second))
    return np.column_stack((prediction.index, best))[keep], first[keep]


def one_to_one(matches: Indices, score: Floats) -> Indices:
    """Keeps for every point its best match only."""
    ordered = matches[np.argsort(-score, kind="stable")]
    for column in (0, 1):
        ordered = ordered[first_of_each(np.ascontiguousarray(ordered[:, column]))]
    return ordered


def union(*found: Indices) -> Indices:
    """All matches (M, 2) of several searches, each once, in their order by index."""
    both = np.concatenate(found)
    keys = np.unique(both[:, 0] << 32 | both[:, 1])  # one column is sorted far faster than two
    return np.column_stack((keys >> 32, keys & 0xFFFFFFFF))
