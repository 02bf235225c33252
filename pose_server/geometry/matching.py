"""Which salient point of one view is which of the other: by descriptor alone, and around a
predicted place.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
NO_MATCHES: Indices = np.zeros((0, 2), np.int64)


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


def similarities(
    descriptors_i: npt.NDArray[np.float32], descriptors_j: npt.NDArray[np.float32]
) -> Floats:
    """(Ni, Nj) cosines of unit descriptors; -1 where the two are of different kinds."""
    if descriptors_i.shape[1] != descriptors_j.shape[1]:
        return np.full((len(descriptors_i), len(descriptors_j)), -1.0, np.float32)
    return descriptors_i @ descriptors_j.T


def ratio_matches(cosines: Floats, ratio: float) -> Indices:
    """Mutual nearest neighbours (M, 2) that are clearly nearer than the second (Lowe 2004).

    Args:
        cosines: (Ni, Nj) similarities; overwritten nowhere.
        ratio: largest allowed distance ratio of nearest and second nearest.
    """
    if min(cosines.shape) < 3:
        return NO_MATCHES
    best_j = cosines.argmax(axis=1)
    best_i = cosines.argmax(axis=0)
    rows = np.arange(len(best_j))
    mutual = best_i[best_j] == rows
    rows, columns = rows[mutual], best_j[mutual]
    candidates = cosines[rows]
    first = candidates[np.arange(len(rows)), columns]
    candidates[np.arange(len(rows)), columns] = -1.0
    second = candidates.max(axis=1, initial=-1.0)
    clear = (1 - np.minimum(first, 1)) < ratio**2 * (1 - second)
    return np.column_stack((rows[clear], columns[clear]))


def guided_matches(
    prediction: Prediction,
    tree: cKDTree,
    inverse_depth: Floats,
    cosines: Floats,
    radius_px: float,
    depth_tolerance: float,
    min_cosine: float = 0.85,
    ratio: float = 0.9,
) -> tuple[Indices, Floats]:
    """The best descriptor within a radius of the predicted place, and clearly better than others
    there.

    Args:
        prediction: places in the target view.
        tree: of the target view's pixels (N, 2).
        inverse_depth: (N,) of the target's points, nan where unknown.
        cosines: (source, target) similarities.
        radius_px: search radius.
        depth_tolerance: largest allowed relative difference of inverse depth, where it is known.
        min_cosine: smallest allowed similarity.
        ratio: largest allowed distance ratio to the best rival more than 3 px away.

    Returns:
        matches (M, 2) of source and target indices, and their cosines (M,).
    """
    if len(prediction.index) == 0 or tree.n < 2:
        return NO_MATCHES, np.zeros(0)
    k = min(24, tree.n)
    distance, near = tree.query(prediction.uv, k=k, distance_upper_bound=radius_px)
    found = np.isfinite(distance)
    near = np.where(found, near, 0)
    offset = np.abs(prediction.inverse_depth[:, None] - inverse_depth[near])
    wrong_depth = offset > depth_tolerance * prediction.inverse_depth[:, None]
    score = np.where(found & ~wrong_depth, cosines[prediction.index[:, None], near], -1.0)
    rows = np.arange(len(score))
    best = score.argmax(axis=1)
    first = score[rows, best]
    pixels = tree.data[near]
    rival = np.linalg.norm(pixels - pixels[rows, best][:, None], axis=2) > 3
    second = np.where(rival, score, -1.0).max(axis=1)
    keep = (first > min_cosine) & ((1 - first) < ratio**2 * (1 - second))
    return np.column_stack((prediction.index[keep], near[rows, best][keep])), first[keep]


def one_to_one(matches: Indices, score: Floats) -> Indices:
    """Keeps for every point its best match only."""
    ordered = matches[np.argsort(-score, kind="stable")]
    for column in (0, 1):
        _, first = np.unique(ordered[:, column], return_index=True)
        ordered = ordered[np.sort(first)]
    return ordered
