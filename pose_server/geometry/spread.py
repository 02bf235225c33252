"""What a set of corresponding points can determine at all, before anything is fitted to it."""

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError

Floats = npt.NDArray[np.floating]

# A direction counts as spanned when its share of the largest one exceeds this.
RANK_TOLERANCE = 0.02  # numerical: a smaller share is noise
_COINCIDENT = 1e-12  # numerical: extent over distance, below it all is rounding
_SHAPES = ("coincide", "lie on one line", "lie in one plane")
_ORDINALS = ("first", "second", "third")


def check_points(p_a: Floats, p_b: Floats) -> tuple[Floats, Floats]:
    """Two (N, 3) arrays as float64, N >= 1, finite.

    Raises:
        DegenerateGeometryError: they are not; the text says what is wrong.
    """
    p_a, p_b = np.asarray(p_a, np.float64), np.asarray(p_b, np.float64)
    if p_a.shape != p_b.shape or p_a.ndim != 2 or p_a.shape[1] != 3:
        raise DegenerateGeometryError(
            f"correspondences of shapes {p_a.shape} and {p_b.shape}, need (N, 3) twice"
        )
    if len(p_a) == 0:
        raise DegenerateGeometryError("0 correspondences, need 1")
    finite = np.isfinite(p_a).all(axis=1) & np.isfinite(p_b).all(axis=1)
    if not finite.all():
        raise DegenerateGeometryError(
            f"{int((~finite).sum())} of {len(p_a)} correspondences are not finite"
        )
    return p_a, p_b


def extents(points: Floats) -> Floats:
    """(3,) root mean square extents along the principal directions, metres, largest first."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return np.concatenate((values, np.zeros(3)))[:3]


def dimension(points: Floats) -> int:
    """How many directions points (N, 3) span: 0 coincident, 1 line, 2 plane, 3 space."""
    values = extents(points)
    if values[0] <= _COINCIDENT * float(np.abs(points).max()) or values[0] < 1e-150:
        return 0
    return int((values > RANK_TOLERANCE * values[0]).sum())


def need_dimension(need: int, *sets: Floats) -> None:
    """Each set of points must span so many directions.

    Raises:
        DegenerateGeometryError: one does not; the text tells its shape and singular values.
    """
    for points in sets:
        spanned = dimension(points)
        if spanned < need:
            values = extents(points)
            raise DegenerateGeometryError(
                f"{len(points)} correspondences {_SHAPES[spanned]}: "
                f"{_ORDINALS[spanned]} singular value {values[spanned]:.3g} m, "
                f"need {RANK_TOLERANCE * values[0]:.3g} m"
            )
