"""Transformations between two sets of corresponding 3D points, from a shift to a projective map.

| model       | dof | from | needs                | source                                      |
|-------------|-----|------|----------------------|---------------------------------------------|
| translation | 3   | 1    | a rotation           | means                                       |
| rigid       | 6   | 3    | not on one line      | Umeyama 1991, eqs. 40-42 without scale      |
| similarity  | 7   | 3    | not on one line      | Umeyama 1991, eqs. 40-42                    |
| affine      | 12  | 4    | not in one plane     | Hartley and Zisserman, 2nd ed., 4.1 and 4.4 |
| projective  | 15  | 5    | no four in one plane | the same, for 4 x 4 matrices                |

A set that does not determine a model steps down to the largest one that it does, and says so. A
similarity is no step on that way: where it is determined a rigid motion is, and metres are metres.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.se3 import make_pose, nearest_rotation, transform
from fleetpose.pose_server.geometry.spread import check_points, dimension, need_dimension
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Model = Literal["translation", "rigid", "similarity", "affine", "projective"]

# The design matrix has rank 15 where it determines a projective map: its 15th singular value must
# exceed this share of the first.
_PROJECTIVE_RANK = 1e-3  # numerical: smallest over largest singular value


@dataclass(frozen=True)
class DltSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    mirrored: float = 3.0  # a mirror image fits so many times better than any rotation
    # scales beyond it, either way, are another unit: 3.3 feet, 39 inches, 1000 mm
    units: float = 2.5
    scale_spread: float = 1.5  # of one scale: nine tenths of all distances over the median, at most


DLT = in_use("dlt", DltSettings())


@dataclass(frozen=True)
class LinearFit:
    """A transformation and the rigid motion nearest to it.

    Attributes:
        model: the largest model that the points determined.
        H: (4, 4) that maps homogeneous points of b to a.
        T_a_b: (4, 4) nearest rigid motion, over the points.
        residuals_m: (N,) distances |p_a - T_a_b p_b|.
        scale: sizes of a over sizes of b, 1 where one point tells none.
        note: empty, or why a smaller model than asked for was fitted.
    """

    model: Model
    H: Floats
    T_a_b: Floats
    residuals_m: Floats
    scale: float = 1.0
    note: str = ""


def translation(p_a: Floats, p_b: Floats, R_a_b: Floats) -> Floats:
    """The motion T_a_b with a given rotation, from one point or more.

    Raises:
        DegenerateGeometryError: no points, or some are not finite.
    """
    p_a, p_b = check_points(p_a, p_b)
    return make_pose(R_a_b, p_a.mean(axis=0) - R_a_b @ p_b.mean(axis=0))


def rigid(p_a: Floats, p_b: Floats, weights: Floats | None = None) -> Floats:
    """The rigid motion T_a_b that minimises sum w |p_a - T p_b|^2 (Umeyama 1991, without scale).

    Raises:
        DegenerateGeometryError: fewer than three points, all on one line in either frame, a mirror
            image, or not finite.
    """
    p_a, p_b = check_points(p_a, p_b)
    need_dimension(2, p_a, p_b)
    _refuse_mirror_image(p_a, p_b)
    return rigid_unchecked(p_a, p_b, weights)


def rigid_unchecked(p_a: Floats, p_b: Floats, weights: Floats | None = None) -> Floats:
    """`rigid` without the tests for degenerate sets and mirror images."""
    w = np.ones(len(p_a)) if weights is None else weights
    w = w / w.sum()
    mean_a, mean_b = w @ p_a, w @ p_b
    cross = (p_a - mean_a).T @ ((p_b - mean_b) * w[:, None])
    R = nearest_rotation(cross)
    return make_pose(R, mean_a - R @ mean_b)


def similarity(p_a: Floats, p_b: Floats) -> Floats:
    """The (4, 4) map p_a = s R p_b + t, s > 0, 7 degrees of freedom (Umeyama 1991, eq. 42).

    Raises:
        DegenerateGeometryError: as `rigid`.
    """
    p_a, p_b = check_points(p_a, p_b)
    T = rigid(p_a, p_b)
    a, b = p_a - p_a.mean(axis=0), p_b - p_b.mean(axis=0)
    sR = T[:3, :3] * float(np.einsum("ni,ij,nj->", a, T[:3, :3], b) / (b**2).sum())
    return make_pose(sR, p_a.mean(axis=0) - sR @ p_b.mean(axis=0))


def affine(p_a: Floats, p_b: Floats) -> Floats:
    """The affine map (4, 4) with p_a = H p_b in the least-squares sense, 12 degrees of freedom.

    Raises:
        DegenerateGeometryError: fewer than four points, all in one plane in b, or not finite.
    """
    p_a, p_b = check_points(p_a, p_b)
    need_dimension(3, p_b)
    N_a, N_b = _normalisation(p_a), _normalisation(p_b)
    a, b = transform(N_a, p_a), transform(N_b, p_b)
    X, *_ = np.linalg.lstsq(np.column_stack((b, np.ones(len(b)))), a, rcond=None)
    H = np.eye(4)
    H[:3] = X.T
    return np.linalg.inv(N_a) @ H @ N_b


def projective(p_a: Floats, p_b: Floats) -> Floats:
    """The projective map (4, 4), H[3, 3] = 1 at the centre of b, 15 degrees of freedom.

    Each correspondence a ~ H b gives three equations h_k . b - a_k (h_4 . b) = 0 (Hartley and
    Zisserman 4.1, one dimension up); the solution is the last right singular vector.

    Raises:
        DegenerateGeometryError: fewer than five points, four of five in one plane, or so placed
            that some lie at infinity; not finite.
    """
    p_a, p_b = check_points(p_a, p_b)
    need_dimension(3, p_b)
    N_a, N_b = _normalisation(p_a), _normalisation(p_b)
    a, b = transform(N_a, p_a), np.column_stack((transform(N_b, p_b), np.ones(len(p_b))))
    A = np.zeros((len(a), 3, 4, 4))
    for k in range(3):
        A[:, k, k] = b
        A[:, k, 3] = -a[:, k, None] * b
    _, values, Vt = np.linalg.svd(A.reshape(-1, 16))
    if len(a) < 5 or values[14] <= _PROJECTIVE_RANK * values[0]:
        fifteenth = values[14] if len(values) > 14 else 0.0
        raise DegenerateGeometryError(
            f"{len(a)} correspondences do not determine a projective map: 15th singular value "
            f"{fifteenth:.3g}, need {_PROJECTIVE_RANK * values[0]:.3g} (normalised)"
        )
    H = Vt[-1].reshape(4, 4)
    w = b @ H[3]
    if w.min() * w.max() <= 0 or np.abs(w).min() < 0.05 * np.abs(w).max():
        raise DegenerateGeometryError("the projective map sends some of the points to infinity")
    return np.linalg.inv(N_a) @ (H / H[3, 3]) @ N_b


def apply(H: Floats, points: Floats) -> Floats:
    """Points (N, 3) mapped by a (4, 4) matrix of any of the models."""
    mapped = points @ H[:, :3].T + H[:, 3]
    return mapped[:, :3] / mapped[:, 3:]


def nearest_rigid(H: Floats, p_b: Floats) -> Floats:
    """The rigid motion nearest to a map over the points (N, 3) where it was determined: that with
    the smallest sum of |H p - T p|^2. For a linear map this is that of the points themselves.

    Raises:
        DegenerateGeometryError: the points lie on one line, or the map mirrors them.
    """
    return rigid(apply(H, p_b), p_b)


def fit(
    p_a: Floats, p_b: Floats, R_a_b: Floats | None = None, largest: Model = "affine"
) -> LinearFit:
    """The largest model that the correspondences determine, up to the one asked for.

    Args:
        p_a: (N, 3) points in frame a, metres.
        p_b: (N, 3) the same points in frame b.
        R_a_b: rotation to keep where only a translation is determined; none: that is an error.
        largest: where to begin stepping down.

    Raises:
        DegenerateGeometryError: no correspondences, points that are not finite, a mirror image,
            sets in different units, or a translation without a rotation to go with it.
    """
    p_a, p_b = check_points(p_a, p_b)
    scale = scale_between(p_a, p_b)
    notes: list[str] = []
    for model in (largest, *_SMALLER[largest]):
        try:
            H = _fitted(model, p_a, p_b, R_a_b)
            T = H if model in ("translation", "rigid") else nearest_rigid(H, p_b)
        except _FatalError:
            raise
        except DegenerateGeometryError as error:
            notes.append(str(error))
            continue
        residuals = np.linalg.norm(p_a - transform(T, p_b), axis=1)
        return LinearFit(model, H, T, residuals, scale, notes[-1] if notes else "")
    raise DegenerateGeometryError("; ".join(dict.fromkeys(notes[-2:])))


def scale_between(p_a: Floats, p_b: Floats) -> float:
    """Sizes of a over sizes of b: the median ratio of the distances between points; 1 for less
    than two distinct ones.

    Raises:
        DegenerateGeometryError: all distances agree on a scale that only other units explain.
    """
    k, m = np.triu_indices(len(p_a), 1)
    of_a, of_b = (np.linalg.norm(p[k] - p[m], axis=1) for p in (p_a, p_b))
    told = np.minimum(of_a, of_b) > 1e-9 * max(np.abs(p_a).max(), np.abs(p_b).max())
    if not told.any():
        return 1.0
    ratios = of_a[told] / of_b[told]
    scale = float(np.median(ratios))
    low, high = np.quantile(ratios, (0.1, 0.9))
    if (
        max(scale, 1 / scale) > DLT.units
        and high < DLT.scale_spread * scale < DLT.scale_spread**2 * low
    ):
        raise DegenerateGeometryError(
            f"distances are {scale:.4g} times as long in one frame as in the other: are both in "
            "metres?"
        )
    return scale


class _FatalError(DegenerateGeometryError):
    """A smaller model would not help."""


_SMALLER: dict[Model, tuple[Model, ...]] = {
    "projective": ("affine", "rigid", "translation"),
    "affine": ("rigid", "translation"),
    "similarity": ("rigid", "translation"),
    "rigid": ("translation",),
    "translation": (),
}


def _fitted(model: Model, p_a: Floats, p_b: Floats, R_a_b: Floats | None) -> Floats:
    if model == "translation":
        if R_a_b is None:
            raise DegenerateGeometryError("no rotation is known: a shift needs one")
        return translation(p_a, p_b, R_a_b)
    return {"projective": projective, "affine": affine, "similarity": similarity, "rigid": rigid}[
        model
    ](p_a, p_b)


def _refuse_mirror_image(p_a: Floats, p_b: Floats) -> None:
    """With a reflection allowed, the residual falls by four times the smallest singular value of
    the cross-covariance (Umeyama 1991, eq. 33, with and without S).
    """
    if min(dimension(p_a), dimension(p_b)) < 3:
        return  # flat sets are their own mirror images
    a, b = p_a - p_a.mean(axis=0), p_b - p_b.mean(axis=0)
    U, d, Vt = np.linalg.svd(a.T @ b)
    if np.linalg.det(U @ Vt) > 0:
        return
    mirrored = max(float((a**2).sum() + (b**2).sum() - 2 * d.sum()), 0.0)
    rotated = mirrored + 4 * float(d[2])
    if rotated > DLT.mirrored**2 * mirrored:
        n = len(a)
        raise _FatalError(
            f"one frame is the mirror image of the other: residual {np.sqrt(rotated / n):.3g} m by "
            f"a rotation, {np.sqrt(mirrored / n):.3g} m by a reflection"
        )


def _normalisation(points: Floats) -> Floats:
    """(4, 4) that brings points to mean 0 and root mean square distance sqrt(3) (H&Z 4.4.4)."""
    mean = points.mean(axis=0)
    scale = np.sqrt(3.0) / max(float(np.sqrt(((points - mean) ** 2).sum(axis=1).mean())), 1e-150)
    N = np.diag([scale, scale, scale, 1.0])
    N[:3, 3] = -scale * mean
    return N
