"""Do the depths of two views fit each other, and the pixels of both?

Pixels of two views determine the structure of what both see up to its size. So one pair tells of
each view how its inverse depths are off by an offset and slopes over the image (a turned camera of
a stereo pair does that), and how the sizes of both differ (a wrong baseline does that). All of it
is fitted at once with the pose, robustly, as in `geometry.refine`.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.resection import resection, seen_at
from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.se3 import hat, retract, transform

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]

LEAST_MATCHES = 20  # that agree in their pixels: fewer may be chance
_MOST_MATCHES = 200  # more say little more
_PRIOR_SCALE = 0.3  # sigma of each view's scale
_PRIOR_BEND = 0.2  # of offset and slopes, as a share of the inverse depth
_NO_BEND = 0.002  # the same, of a view whose depths do not bend: then the scale is known better
_ITERATIONS, _LOOSE_ITERATIONS, _LOOSE = 9, 3, 4.0  # the first ones take larger errors for good
_SETTLED_SIGMAS = 0.05
_NOISE_FLOOR = 1.0  # noise that is smaller than stated is taken for luck
_GEMAN_MCCLURE = 9.0
_MEDIAN_CHI2_3 = 2.366


@dataclass(frozen=True)
class DepthErrors:
    """How the depths of views i and j are off, as far as the two tell.

    Attributes:
        matches: number of matches that agree.
        scale: log of the size of things seen by j over that seen by i, if neither view's depths
            bend: positive where j's depths are too long, or i's too short.
        scale_sigma: of it.
        bend_i, bend_j: (3,) error of the inverse depths of each view, 1/m: in the middle of the
            image, and how much more at its right and at its lower edge.
        covariance_i, covariance_j: (3, 3) of these.
        inverse_depth: (2,) medians of both views, 1/m.
    """

    matches: int
    scale: float
    scale_sigma: float
    bend_i: Floats
    bend_j: Floats
    covariance_i: Floats
    covariance_j: Floats
    inverse_depth: Floats

    def swapped(self) -> "DepthErrors":
        """The same with i and j exchanged."""
        return replace(
            self,
            scale=-self.scale,
            bend_i=self.bend_j,
            bend_j=self.bend_i,
            covariance_i=self.covariance_j,
            covariance_j=self.covariance_i,
            inverse_depth=self.inverse_depth[::-1],
        )


def compare_depths(
    i: Observed, j: Observed, matches: Indices, T_i_j: Floats | None
) -> DepthErrors | None:
    """Compares two views' depths.

    Args:
        i, j: salient points.
        matches: (M, 2) by descriptor alone, of points with depth in both.
        T_i_j: where a good pose is known; otherwise it is looked for by each view's pixels.

    Returns:
        None where too few matches agree in any pose.
    """
    if len(matches) < LEAST_MATCHES:
        return None
    if T_i_j is not None:
        agree = seen_at(j, i, matches[:, ::-1], T_i_j)
        if agree.sum() >= LEAST_MATCHES:
            return _compared(i, j, matches[agree], T_i_j)
    forth, back = resection(j, i, matches[:, ::-1]), resection(i, j, matches)
    if forth is None or back is None:
        return None
    if forth[1].sum() >= back[1].sum():
        return _compared(i, j, matches[forth[1]], forth[0])
    mirrored = _compared(j, i, matches[back[1]][:, ::-1], back[0])
    return None if mirrored is None else mirrored.swapped()


class _Matched:
    """Matched points of views i and j, and the residuals of a pose and both calibrations.

    Parameters (14,): left increment of T_i_j (6), then log scale and bend of i (4) and of j (4):
    `q_seen = exp(-scale) q + bend . shape`, the shape (3,) being that of `_over_image`.
    """

    def __init__(self, i: Observed, j: Observed, matches: Indices) -> None:
        self.i, self.j = i, j
        self.uv_i, self.uv_j = i.uv[matches[:, 0]], j.uv[matches[:, 1]]
        self.q_i, self.q_j = i.inverse_depth[matches[:, 0]], j.inverse_depth[matches[:, 1]]
        self.sigma_i = i.inverse_depth_sigma[matches[:, 0]]
        self.sigma_j = j.inverse_depth_sigma[matches[:, 1]]
        self.over_i, self.over_j = _over_image(i, self.uv_i), _over_image(j, self.uv_j)
        self.rays_j = np.column_stack((self.uv_j, np.ones(len(matches)))) @ np.linalg.inv(j.K).T

    def predicted(self, T_i_j: Floats, error_j: Floats) -> tuple[Floats, Floats, Floats]:
        """Points of j by its calibration, in j and in i, and their inverse depths in j."""
        q = (self.q_j - self.over_j @ error_j[1:]) * np.exp(error_j[0])
        q = np.maximum(q, 0.02 * self.q_j)
        X = self.rays_j / q[:, None]
        return X, transform(T_i_j, X), q

    def residuals(
        self, T: Floats, errors: Floats, depth_noise: float
    ) -> tuple[Floats, Floats, Floats]:
        """(M, 3) of pixel and inverse depth in i, (M, 3, 14) derivatives, (M, 3, 3) inverse
        covariances.
        """
        e_i, e_j = errors[:4], errors[4:]
        X, Y, q = self.predicted(T, e_j)
        z = np.maximum(Y[:, 2], 1e-3 * np.median(X[:, 2]))
        fx, fy = self.i.K[0, 0], self.i.K[1, 1]
        shrink = np.exp(-e_i[0])
        r = np.column_stack(
            (
                fx * Y[:, 0] / z + self.i.K[0, 2] - self.uv_i[:, 0],
                fy * Y[:, 1] / z + self.i.K[1, 2] - self.uv_i[:, 1],
                shrink / z + self.over_i @ e_i[1:] - self.q_i,
            )
        )
        JP = np.zeros((len(z), 3, 3))
        JP[:, 0, 0], JP[:, 0, 2] = fx / z, -fx * Y[:, 0] / z**2
        JP[:, 1, 1], JP[:, 1, 2] = fy / z, -fy * Y[:, 1] / z**2
        JP[:, 2, 2] = -shrink / z**2
        by_point = JP @ T[:3, :3]
        by_q = -np.einsum("mkl,ml->mk", by_point, X) / q[:, None]
        stretch = float(np.exp(e_j[0]))
        J = np.zeros((len(z), 3, 14))
        J[:, :, :3], J[:, :, 3:6] = JP @ -hat(Y), JP
        J[:, 2, 6], J[:, 2, 7:10] = -shrink / z, self.over_i
        J[:, :, 10] = by_q * q[:, None]
        J[:, :, 11:] = -stretch * by_q[:, :, None] * self.over_j[:, None, :]
        across = self.j.pixel_sigma_px * X[:, 2] / self.j.focal_px
        C = (across**2)[:, None, None] * (by_point @ by_point.transpose(0, 2, 1))
        along = by_q * (stretch * depth_noise * self.sigma_j)[:, None]
        C += along[:, :, None] * along[:, None, :]
        C[:, 0, 0] += self.i.pixel_sigma_px**2
        C[:, 1, 1] += self.i.pixel_sigma_px**2
        C[:, 2, 2] += (depth_noise * self.sigma_i) ** 2
        return r, J, np.linalg.inv(C)


def _compared(i: Observed, j: Observed, matches: Indices, T_i_j: Floats) -> DepthErrors | None:
    matches = matches[:: 1 + len(matches) // _MOST_MATCHES]
    if len(matches) < LEAST_MATCHES:
        return None
    matched = _Matched(i, j, matches)
    medians = np.array((np.median(matched.q_i), np.median(matched.q_j)))
    prior = np.zeros(14)
    prior[[6, 10]] = _PRIOR_SCALE**-2
    prior[7:10] = prior[11:] = (_PRIOR_BEND * medians.max()) ** -2.0  # one may be far too small
    T, errors = T_i_j, _first_errors(matched, T_i_j)
    for step in range(_ITERATIONS):
        depth_noise = _LOOSE if step < _LOOSE_ITERATIONS else 1.0
        gradient, H, _ = _normal_equations(matched, T, errors, prior, depth_noise)
        if not np.isfinite(H).all():
            return None
        increment = -np.linalg.solve(H, gradient)
        increment *= min(1.0, 0.3 / max(float(np.linalg.norm(increment[:3])), 1e-9))
        T, errors = retract(T, increment[:6]), errors + increment[6:]
        if depth_noise == 1.0 and increment @ H @ increment < _SETTLED_SIGMAS**2:
            break
    _, H, good = _normal_equations(matched, T, errors, prior, 1.0)
    if good < LEAST_MATCHES or not np.isfinite(H).all():
        return None
    C = np.linalg.inv(H)[6:, 6:]
    scale, sigma = _scale_without_bend(errors, C, medians)
    return DepthErrors(
        matches=good,
        scale=scale,
        scale_sigma=sigma,
        bend_i=errors[1:4],
        bend_j=errors[5:],
        covariance_i=C[1:4, 1:4],
        covariance_j=C[5:, 5:],
        inverse_depth=medians,
    )


def _normal_equations(
    matched: _Matched, T: Floats, errors: Floats, prior: Floats, depth_noise: float
) -> tuple[Floats, Floats, int]:
    """Gradient (14,), Hessian (14, 14), and how many matches agree."""
    r, J, W = matched.residuals(T, errors, depth_noise)
    distance = np.einsum("mk,mkl,ml->m", r, W, r)
    noise = max(_NOISE_FLOOR, float(np.median(distance)) / _MEDIAN_CHI2_3)
    weight = 1.0 / (1.0 + distance / (_GEMAN_MCCLURE * noise)) ** 2
    WJ = W @ J * (weight / noise)[:, None, None]
    gradient = np.einsum("mki,mk->i", WJ, r) + prior * np.concatenate((np.zeros(6), errors))
    H = np.einsum("mki,mkj->ij", J, WJ) + np.diag(prior)
    return gradient, H, int((distance < 2 * _GEMAN_MCCLURE * noise).sum())


def _scale_without_bend(errors: Floats, C: Floats, medians: Floats) -> tuple[float, float]:
    """Difference of the scales and its sigma, given that the bends (nearly) vanish."""
    difference = np.array((-1.0, 0, 0, 0, 1.0, 0, 0, 0))
    bends = np.array((1, 2, 3, 5, 6, 7))
    nearly = np.diag(np.repeat((_NO_BEND * medians) ** 2, 3))
    gain = np.linalg.solve(C[np.ix_(bends, bends)] + nearly, C[bends] @ difference)
    variance = difference @ C @ difference - gain @ C[bends] @ difference
    return float(difference @ errors - gain @ errors[bends]), float(np.sqrt(max(variance, 0.0)))


def _first_errors(matched: _Matched, T_i_j: Floats) -> Floats:
    """Errors (8,) of i that bring its inverse depths to what j's points say; j is taken for
    right.
    """
    _, Y, _ = matched.predicted(T_i_j, np.zeros(4))
    q = 1.0 / np.maximum(Y[:, 2], 1e-3 * np.median(np.abs(Y[:, 2])))
    A = np.column_stack((q, matched.over_i))
    scale = np.median(matched.q_i)
    ridge = np.diag([1.0, 1.0, 1.0, 1.0]) * 1e-4 * len(q)
    A[:, 0] /= scale
    solution = np.array((scale, 0.0, 0.0, 0.0))
    weight = np.ones(len(q))
    first = solution.copy()
    for _ in range(6):
        AW = A.T * weight
        solution = first + np.linalg.solve(AW @ A + ridge, AW @ (matched.q_i - A @ first))
        off = np.abs(matched.q_i - A @ solution)
        weight = 1.0 / (1.0 + (off / max(2.0 * float(np.median(off)), 1e-9)) ** 2) ** 2
    size = float(np.clip(solution[0] / scale, 0.2, 5.0))
    return np.concatenate(([-np.log(size)], solution[1:], np.zeros(4)))


def _over_image(view: Observed, uv: Floats) -> Floats:
    """(M, 3): how an offset shows, and where a pixel lies from -1 to 1 over the width and height.

    A camera of a stereo pair that is turned sideways shifts disparities by 1 + x^2, x the tangent.
    """
    half = 0.5 * (np.array(view.size) - 1)
    x = (uv[:, 0] - view.K[0, 2]) / view.focal_px
    return np.column_stack((1 + x**2, uv / half - 1))
