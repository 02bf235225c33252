"""Inner loops of matching and refinement, compiled by numba.

As numpy expressions they gather hundreds of bytes per candidate and write stacks of small matrices,
and took most of an alignment's time. They are compiled when this module is first imported on a
machine, which takes a while, and kept on disk.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Descriptors = npt.NDArray[np.float32]

_NO_DEPTH_VARIANCE = 1e6  # numerical: times the variance it replaces, the residual says nothing


@njit("i8(f8, f8, i8)", cache=True, inline="always")
def _cell(value: float, cell_px: float, count: int) -> int:
    return min(max(int(value // cell_px), 0), count - 1)


@njit("i8[::1](i8[::1])", cache=True)
def first_of_each(values: Indices) -> Indices:
    """Where each of the values (N,), none negative, comes first, in order."""
    seen = np.zeros(values.max() + 1 if len(values) else 0, np.bool_)
    first = np.empty(len(values), np.int64)
    count = 0
    for n in range(len(values)):
        if not seen[values[n]]:
            seen[values[n]] = True
            first[count] = n
            count += 1
    return first[:count]


@njit("f8(f4[::1], f4[::1])", cache=True, fastmath={"reassoc", "contract"})
def _dot(a: Descriptors, b: Descriptors) -> float:
    total = np.float32(0.0)
    for k in range(a.shape[0]):
        total += a[k] * b[k]
    return np.float64(total)


@njit(
    "Tuple((i8[::1], f8[::1], f8[::1]))"
    "(f8[:, ::1], f8[::1], i8[::1], f4[:, ::1], i8[::1], i8[::1], i8, f8,"
    " f8[:, ::1], f8[::1], f4[:, ::1], f8, f8, f8)",
    cache=True,
)
def best_around(
    uv: Floats,
    inverse_depth: Floats,
    index: Indices,
    descriptors: Descriptors,
    begin: Indices,
    order: Indices,
    columns: int,
    cell_px: float,
    uv_there: Floats,
    inverse_depth_there: Floats,
    descriptors_there: Descriptors,
    radius_px: float,
    depth_tolerance: float,
    same_place_px: float,
) -> tuple[Indices, Floats, Floats]:
    """For each predicted place (M,) the best descriptor around it, -1 for none, its cosine, and the
    cosine of the best one at another place.

    `begin`, `order`, `columns` and `cell_px` are a grid over `uv_there`: the points of cell c are
    `order[begin[c] : begin[c + 1]]`.
    """
    count = len(index)
    best = np.full(count, -1, np.int64)
    first = np.full(count, -1.0)
    second = np.full(count, -1.0)
    rows = (len(begin) - 1) // columns
    near = np.empty(len(order), np.int64)
    score = np.empty(len(order))
    for m in range(count):
        u, v, q = uv[m, 0], uv[m, 1], inverse_depth[m]
        left, right = _cell(u - radius_px, cell_px, columns), _cell(u + radius_px, cell_px, columns)
        found = 0
        for row in range(
            _cell(v - radius_px, cell_px, rows), _cell(v + radius_px, cell_px, rows) + 1
        ):
            for k in range(begin[row * columns + left], begin[row * columns + right + 1]):
                n = order[k]
                du, dv = uv_there[n, 0] - u, uv_there[n, 1] - v
                if du * du + dv * dv > radius_px * radius_px:
                    continue
                if abs(q - inverse_depth_there[n]) > depth_tolerance * q:  # not where unknown
                    continue
                near[found] = n
                score[found] = _dot(descriptors[index[m]], descriptors_there[n])
                if score[found] > first[m]:
                    first[m], best[m] = score[found], n
                found += 1
        for k in range(found):
            du = uv_there[near[k], 0] - uv_there[best[m], 0]
            dv = uv_there[near[k], 1] - uv_there[best[m], 1]
            if du * du + dv * dv > same_place_px * same_place_px and score[k] > second[m]:
                second[m] = score[k]
    return best, first, second


@njit(
    "void(f8[:, ::1], f8[::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], f8, f8, f8,"
    " f8, i8[::1], f8[:, ::1], f8[:, :, ::1])",
    cache=True,
)
def residuals_of(
    X: Floats,
    sigma_q: Floats,
    uv: Floats,
    q_there: Floats,
    sigma_q_there: Floats,
    T: Floats,
    K_there: Floats,
    direction_sigma: float,
    pixel_sigma_px: float,
    depth_scale: float,
    sign: float,
    at: Indices,
    out: Floats,
    jacobians: Floats,
) -> None:
    """Whitened residuals of lifted points X (M, 3) in another view, written to rows `at`.

    A residual is (u, v, 1/z) of the moved point less what was measured there, and is judged by the
    covariance S of both points: S = L L^T, whitened L^-1 r.

    Args:
        X, sigma_q: points, camera frame, and sigmas of their inverse depth.
        uv, q_there, sigma_q_there: what was measured there; nan where there is no depth.
        T: T_there_here.
        K_there: (3, 3) intrinsics of the other view.
        direction_sigma: of a point across its ray, radians.
        pixel_sigma_px: of a pixel there.
        depth_scale: factor on all sigmas of depths.
        sign: +1 for derivatives by the left increment of T, -1 by that of its inverse.
        out: (N, 5) whitened squared length, whether it is behind, the residual across the epipolar
            line, |1/z residual| over its sigma, whether depth was compared.
        jacobians: (N, 3, 7) whitened Jacobian by the increment (rotation first), and the residual.
    """
    fx, fy, cx, cy = K_there[0, 0], K_there[1, 1], K_there[0, 2], K_there[1, 2]
    nearest = np.median(X[:, 2]) * 1e-3
    JP = np.zeros((3, 3))
    JR = np.zeros((3, 3))
    C = np.zeros((3, 3))
    L = np.zeros((3, 3))
    J = np.zeros((3, 7))
    ray = np.zeros(3)
    Y = np.zeros(3)
    for m in range(X.shape[0]):
        n = at[m]
        for r in range(3):
            Y[r] = T[r, 0] * X[m, 0] + T[r, 1] * X[m, 1] + T[r, 2] * X[m, 2] + T[r, 3]
            ray[r] = X[m, r] / X[m, 2]
        z = max(Y[2], nearest)
        known = np.isfinite(q_there[m])
        JP[0, 0], JP[0, 2] = fx / z, -fx * Y[0] / (z * z)
        JP[1, 1], JP[1, 2] = fy / z, -fy * Y[1] / (z * z)
        JP[2, 2] = -1.0 / (z * z)
        for r in range(3):
            for c in range(3):
                JR[r, c] = JP[r, 0] * T[0, c] + JP[r, 1] * T[1, c] + JP[r, 2] * T[2, c]
        J[0, 6] = fx * Y[0] / z + cx - uv[m, 0]
        J[1, 6] = fy * Y[1] / z + cy - uv[m, 1]
        J[2, 6] = 1.0 / z - q_there[m] if known else 0.0
        along = depth_scale * sigma_q[m] * X[m, 2] ** 2
        across = direction_sigma * X[m, 2]
        e0 = JR[0, 0] * ray[0] + JR[0, 1] * ray[1] + JR[0, 2] * ray[2]
        e1 = JR[1, 0] * ray[0] + JR[1, 1] * ray[1] + JR[1, 2] * ray[2]
        e2 = JR[2, 0] * ray[0] + JR[2, 1] * ray[1] + JR[2, 2] * ray[2]
        e = (e0, e1, e2)
        for r in range(3):
            for c in range(3):
                shared = JR[r, 0] * JR[c, 0] + JR[r, 1] * JR[c, 1] + JR[r, 2] * JR[c, 2]
                C[r, c] = across * across * shared + along * along * e[r] * e[c]
        C[0, 0] += pixel_sigma_px**2
        C[1, 1] += pixel_sigma_px**2
        C[2, 2] += (depth_scale * sigma_q_there[m]) ** 2 if known else _NO_DEPTH_VARIANCE * C[2, 2]
        for r in range(3):
            if sign > 0:  # JP [-hat(Y), I]
                J[r, 0] = -JP[r, 1] * Y[2] + JP[r, 2] * Y[1]
                J[r, 1] = JP[r, 0] * Y[2] - JP[r, 2] * Y[0]
                J[r, 2] = -JP[r, 0] * Y[1] + JP[r, 1] * Y[0]
                J[r, 3], J[r, 4], J[r, 5] = JP[r, 0], JP[r, 1], JP[r, 2]
            else:  # JP R [hat(X), -I]
                J[r, 0] = JR[r, 1] * X[m, 2] - JR[r, 2] * X[m, 1]
                J[r, 1] = -JR[r, 0] * X[m, 2] + JR[r, 2] * X[m, 0]
                J[r, 2] = JR[r, 0] * X[m, 1] - JR[r, 1] * X[m, 0]
                J[r, 3], J[r, 4], J[r, 5] = -JR[r, 0], -JR[r, 1], -JR[r, 2]
        length = max(np.sqrt(e0 * e0 + e1 * e1), 1e-9)
        out[n, 1] = Y[2] <= nearest
        out[n, 2] = (e0 * J[1, 6] - e1 * J[0, 6]) / length
        out[n, 3] = abs(J[2, 6]) / np.sqrt(C[2, 2])
        out[n, 4] = known
        # Cholesky factor, and the rows whitened by it
        L[0, 0] = np.sqrt(C[0, 0])
        L[1, 0] = C[1, 0] / L[0, 0]
        L[2, 0] = C[2, 0] / L[0, 0]
        L[1, 1] = np.sqrt(max(C[1, 1] - L[1, 0] ** 2, 1e-300))
        L[2, 1] = (C[2, 1] - L[2, 0] * L[1, 0]) / L[1, 1]
        L[2, 2] = np.sqrt(max(C[2, 2] - L[2, 0] ** 2 - L[2, 1] ** 2, 1e-300))
        total = 0.0
        for c in range(7):
            a = J[0, c] / L[0, 0]
            b = (J[1, c] - L[1, 0] * a) / L[1, 1]
            d = (J[2, c] - L[2, 0] * a - L[2, 1] * b) / L[2, 2]
            jacobians[n, 0, c], jacobians[n, 1, c], jacobians[n, 2, c] = a, b, d
            if c == 6:
                total = a * a + b * b + d * d
        out[n, 0] = total


@njit("f8[:, ::1](f8[:, :, ::1], f8[::1])", cache=True)
def normal_equations(jacobians: Floats, weights: Floats) -> Floats:
    """(7, 7) sum of w [J r]^T [J r]: H, the gradient in the last column, the cost in the corner."""
    out = np.zeros((7, 7))
    for m in range(jacobians.shape[0]):
        w = weights[m]
        if w == 0.0:
            continue
        for k in range(3):
            for r in range(7):
                scaled = w * jacobians[m, k, r]
                for c in range(r, 7):
                    out[r, c] += scaled * jacobians[m, k, c]
    for r in range(7):
        for c in range(r):
            out[r, c] = out[c, r]
    return out
