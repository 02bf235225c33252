"""Linear transformations between two sets of corresponding 3D points.

Translation from one or two points, rigid from three (Umeyama 1991), affine from four by the Direct
Linear Transformation with Hartley's normalisation (Hartley and Zisserman, 2nd ed., 4.4). A set
that does not determine a model steps down to the largest one that it does, and says so.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt

from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.se3 import make_pose, nearest_rotation, transform

Floats = npt.NDArray[np.floating]
Model = Literal["translation", "rigid", "affine"]

# A direction counts as spanned when its share of the largest one exceeds this.
_RANK_TOLERANCE = 0.02
_ALL_TRIPLES_UP_TO, _DRAWN_TRIPLES = 12, 220


@dataclass(frozen=True)
class LinearFit:
    """A linear transformation and the rigid motion nearest to it.

    Attributes:
        model: the largest model that the points determined.
        H: (4, 4) transformation that maps points of b to a, affine where the model is.
        T_a_b: (4, 4) nearest rigid motion.
        residuals_m: (N,) distances |p_a - T_a_b p_b|.
        inliers: (N,) which correspondences the fit uses.
        note: empty, or why a smaller model than usual was fitted.
    """

    model: Model
    H: Floats
    T_a_b: Floats
    residuals_m: Floats
    inliers: npt.NDArray[np.bool_]
    note: str = ""


def rigid(p_a: Floats, p_b: Floats, weights: Floats | None = None) -> Floats:
    """The rigid motion T_a_b that minimises sum w |p_a - T p_b|^2 (Umeyama 1991, without scale).

    Raises:
        DegenerateGeometryError: fewer than three points, or all on one line.
    """
    spread = _singular_values(p_b)
    if len(p_b) < 3 or spread[1] <= _RANK_TOLERANCE * max(spread[0], 1e-12):
        raise DegenerateGeometryError(
            f"{len(p_b)} correspondences lie on one line: second singular value {spread[1]:.3g} m, "
            f"need {_RANK_TOLERANCE * spread[0]:.3g} m"
        )
    return rigid_unchecked(p_a, p_b, weights)


def rigid_unchecked(p_a: Floats, p_b: Floats, weights: Floats | None = None) -> Floats:
    """`rigid` without the test for degenerate sets."""
    w = np.ones(len(p_a)) if weights is None else weights
    w = w / w.sum()
    mean_a, mean_b = w @ p_a, w @ p_b
    cross = (p_a - mean_a).T @ ((p_b - mean_b) * w[:, None])
    R = nearest_rotation(cross)
    return make_pose(R, mean_a - R @ mean_b)


def affine(p_a: Floats, p_b: Floats) -> Floats:
    """The affine map (4, 4) with p_a = H p_b in the least-squares sense, 12 degrees of freedom.

    Raises:
        DegenerateGeometryError: fewer than four points, or all in one plane.
    """
    spread = _singular_values(p_b)
    if len(p_b) < 4 or spread[2] <= _RANK_TOLERANCE * max(spread[0], 1e-12):
        raise DegenerateGeometryError(
            f"{len(p_b)} correspondences lie in one plane: third singular value {spread[2]:.3g} m, "
            f"need {_RANK_TOLERANCE * spread[0]:.3g} m"
        )
    N_a, N_b = _normalisation(p_a), _normalisation(p_b)
    a, b = transform(N_a, p_a), transform(N_b, p_b)
    X, *_ = np.linalg.lstsq(np.column_stack((b, np.ones(len(b)))), a, rcond=None)
    H = np.eye(4)
    H[:3] = X.T
    return np.linalg.inv(N_a) @ H @ N_b


def fit(
    p_a: Floats, p_b: Floats, R_a_b: Floats | None = None, inlier_m: float | None = None
) -> LinearFit:
    """The largest model that the correspondences determine, robust from four on.

    Args:
        p_a: (N, 3) points in frame a, metres.
        p_b: (N, 3) the same points in frame b.
        R_a_b: rotation to keep where only a translation is determined; identity if not known.
        inlier_m: distance within which a correspondence agrees; none: all are used.

    Raises:
        DegenerateGeometryError: no correspondences, or points that are not finite.
    """
    if len(p_a) == 0 or not (np.isfinite(p_a).all() and np.isfinite(p_b).all()):
        raise DegenerateGeometryError(
            f"{len(p_a)} correspondences, some of them not finite or none"
        )
    inliers = _consensus(p_a, p_b, inlier_m)
    a, b = p_a[inliers], p_b[inliers]
    model, H, note = _largest_model(a, b, np.eye(3) if R_a_b is None else R_a_b)
    T = H if model != "affine" else rigid(a, b)
    residuals = np.linalg.norm(p_a - transform(T, p_b), axis=1)
    return LinearFit(model, H, T, residuals, inliers, note)


def _largest_model(a: Floats, b: Floats, R: Floats) -> tuple[Model, Floats, str]:
    note = ""
    if len(a) >= 4:
        try:
            return "affine", affine(a, b), note
        except DegenerateGeometryError as error:
            note = str(error)
    if len(a) >= 3:
        try:
            return "rigid", rigid(a, b), note
        except DegenerateGeometryError as error:
            note = str(error)
    return "translation", make_pose(R, (a - b @ R.T).mean(axis=0)), note


def _consensus(p_a: Floats, p_b: Floats, inlier_m: float | None) -> npt.NDArray[np.bool_]:
    """The largest set that one rigid motion of three correspondences explains; all triples are
    tried up to 12 points.
    """
    everyone = np.ones(len(p_a), bool)
    if inlier_m is None or len(p_a) < 4:
        return everyone
    best, best_score = everyone, -1.0
    for index in _triples(len(p_a)):
        try:
            T = rigid(p_a[index], p_b[index])
        except DegenerateGeometryError:
            continue
        distance = np.linalg.norm(p_a - transform(T, p_b), axis=1)
        agrees = distance < inlier_m
        score = agrees.sum() - (distance[agrees] / inlier_m).mean() if agrees.any() else -1.0
        if agrees.sum() >= 3 and score > best_score:
            best, best_score = agrees, score
    return best


def _triples(count: int) -> npt.NDArray[np.int64]:
    """Three different indices per row: all combinations where they are few, else drawn by chance
    but the same every time.
    """
    if count <= _ALL_TRIPLES_UP_TO:
        return np.array(list(combinations(range(count), 3)))
    rng = np.random.default_rng(0)
    return np.array([rng.choice(count, 3, replace=False) for _ in range(_DRAWN_TRIPLES)])


def _singular_values(points: Floats) -> Floats:
    """Root mean square extent along the three principal directions, metres, largest first."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return np.concatenate((values, np.zeros(3)))[:3]


def _normalisation(points: Floats) -> Floats:
    mean = points.mean(axis=0)
    scale = np.sqrt(3.0) / max(float(np.sqrt(((points - mean) ** 2).sum(axis=1).mean())), 1e-12)
    N = np.diag([scale, scale, scale, 1.0])
    N[:3, 3] = -scale * mean
    return N
