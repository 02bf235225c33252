"""Types for numpy arrays in messages: dtype, shape and finiteness are checked when a message is
made or read.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, PlainSerializer

Shape = tuple[int | None, ...]
MAX_DISTANCE_M = 1e8  # between two frames
MAX_COVARIANCE = 1e30
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


def _checked(dtype: str, shape: Shape, finite: bool) -> Any:
    wanted = np.dtype(dtype)

    def check(value: Any) -> npt.NDArray[Any]:
        array = np.asarray(value)
        if array.dtype.hasobject or array.dtype.kind not in "fiub":
            raise ValueError(f"array of dtype {array.dtype} is refused")
        if array.ndim != len(shape) or any(
            n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
        ):
            raise ValueError(f"array of shape {array.shape}, need {shape}")
        if finite and array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError("array holds nan or inf")
        array = np.ascontiguousarray(array, dtype=wanted)
        array.flags.writeable = False
        return array

    return check


def array_type(dtype: str, *shape: int | None, finite: bool = True) -> Any:
    """An annotated array type for a message field; None in the shape is any length."""
    return Annotated[
        np.ndarray,
        BeforeValidator(_checked(dtype, shape, finite)),
        PlainSerializer(lambda array: array, return_type=Any),
    ]


_four_by_four, _six_by_six = _checked("f8", (4, 4), True), _checked("f8", (6, 6), True)


def _check_rigid(value: Any) -> npt.NDArray[np.float64]:
    T = _four_by_four(value)
    # so few numbers are quicker without numpy, and poses come in hundreds
    x, y, z, last = T.tolist()
    if max(abs(a - b) for a, b in zip(last, _LAST_ROW, strict=True)) > 1e-5:
        raise ValueError("last row of a pose is not 0 0 0 1")
    if not _are_axes(x[:3], y[:3], z[:3]):
        raise ValueError("rotation of a pose is not orthonormal")
    if max(abs(x[3]), abs(y[3]), abs(z[3])) > MAX_DISTANCE_M:
        raise ValueError(f"a pose farther than {MAX_DISTANCE_M:g} m")
    return T


def _are_axes(x: list[float], y: list[float], z: list[float]) -> bool:
    """Whether three rows are at right angles, of length 1, and right-handed."""
    if max(map(abs, (*x, *y, *z))) > 1.01:
        return False
    products = (_dot(x, y), _dot(y, z), _dot(z, x), _dot(x, x) - 1, _dot(y, y) - 1, _dot(z, z) - 1)
    normal = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    return max(map(abs, products)) <= 1e-3 and _dot(normal, z) > 0


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _check_square(value: Any) -> npt.NDArray[np.float64]:
    C = _six_by_six(value)
    if np.abs(C).max() > MAX_COVARIANCE:
        raise ValueError(f"a covariance above {MAX_COVARIANCE:g}")
    return C


if TYPE_CHECKING:  # to a type checker they are plain arrays
    Pose: TypeAlias = npt.NDArray[Any]
    Vector3: TypeAlias = npt.NDArray[Any]
    Matrix3: TypeAlias = npt.NDArray[Any]
    Matrix6: TypeAlias = npt.NDArray[Any]
    Pixel: TypeAlias = npt.NDArray[Any]
    ClickedPixel: TypeAlias = npt.NDArray[Any]
else:
    Pose = Annotated[
        np.ndarray, BeforeValidator(_check_rigid), PlainSerializer(lambda a: a, return_type=Any)
    ]
    """(4, 4) float64 rigid motion `T_a_b`, metres: maps points of frame b to frame a."""
    Vector3 = array_type("f8", 3)
    Matrix3 = array_type("f8", 3, 3)
    Matrix6 = Annotated[
        np.ndarray, BeforeValidator(_check_square), PlainSerializer(lambda a: a, return_type=Any)
    ]
    Pixel = array_type("f8", 2)
    ClickedPixel = array_type("f8", 2, finite=False)
    """As an operator's client sends it: one that is no number is rejected with a receipt."""
