"""Which robot's calibration is off, by what its pairs with others say.

A pair says only that two robots differ in scale; who is wrong is told by their other partners. How
the depths of a view bend, every partner says by itself. Views of one pair share their errors, so
that a partner counts once, however often both were compared.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.keys import RobotPair

Floats = npt.NDArray[np.floating]

LEAST_SCALE = 0.03  # recordings whose calibration is right show up to 2.6 %
# Of the inverse depth, root mean square over the image. A stereo pair's depths bend by less than
# 4 % where its calibration is right, those of a cheap depth camera by up to a tenth.
LEAST_BEND_STEREO, LEAST_BEND_OTHER = 0.10, 0.20
LEAST_OFFSET_S = 0.02
_SIGMAS = 5.0
# Partners that agree may do so by luck: depths of stereo and of depth cameras err by so much from
# scene to scene (shares of the inverse depth), in recordings whose calibration is right.
_SCALE_SCATTER, _BEND_SCATTER = 0.007, 0.02
_MEDIAN_SIGMA = 1.2533  # of the median of normal errors, over that of their mean
_MAD_SIGMA = 1.4826
_GEMAN_MCCLURE, _MEDIAN_CHI2_3, _ROUNDS = 9.0, 2.366, 10
_LEAST_MEASURED = 6  # to tell a time offset


@dataclass(frozen=True)
class Estimate:
    """A value, its sigma, and how many partners agree on it."""

    value: float
    sigma: float
    partners: int

    @property
    def significance(self) -> float:
        """How many sigmas it is from zero."""
        return abs(self.value) / self.sigma


@dataclass(frozen=True)
class Bend:
    """How inverse depths are off, 1/m: (3,) in the middle of the image, and more at its right and
    at its lower edge, with sigmas (3,); and how many partners agree.
    """

    value: Floats
    sigma: Floats
    partners: int


@dataclass(frozen=True)
class Scales:
    """Robots whose depths are too long (positive) or too short, as logarithms, and pairs that
    differ of which nobody tells who is wrong: the first one's depths are longer by so much.
    """

    wrong: dict[str, Estimate]
    undecided: dict[RobotPair, Estimate]


def wrong_scales(pairs: Mapping[RobotPair, tuple[float, float]]) -> Scales:
    """The fewest robots whose scale explains what the pairs say.

    A robot is suspect against two partners or more, or against one that agrees with two others.

    Args:
        pairs: log of the size that the first robot sees over that of the second one, and its
            sigma.
    """
    left, wrong = dict(pairs), dict[str, Estimate]()
    robots = {robot for pair in pairs for robot in pair}
    while True:
        found = {robot: _against_partners(robot, left) for robot in sorted(robots)}
        off = {r: e for r, e in found.items() if e is not None and _is_off(e)}
        if not off:
            break
        worst = max(off, key=lambda robot: (off[robot].partners, off[robot].significance))
        wrong[worst] = off[worst]
        left = {pair: said for pair, said in left.items() if worst not in pair}
    single = {pair: _of_pair(*said) for pair, said in left.items()}
    agreeing = Counter(r for pair, e in single.items() if not _is_off(e) for r in pair)
    undecided = {}
    for (a, b), estimate in single.items():
        if not _is_off(estimate) or (agreeing[a] and agreeing[b]):
            continue  # two that others agree with have matched two copies of something
        if not agreeing[a] and not agreeing[b]:
            undecided[a, b] = estimate
        elif agreeing[a] >= 2:
            wrong[b] = Estimate(-estimate.value, estimate.sigma, 1)
        elif agreeing[b] >= 2:
            wrong[a] = estimate
    if 2 * len(wrong) >= len(robots):  # no majority is right
        return Scales({}, {p: e for p, s in pairs.items() if _is_off(e := _of_pair(*s))})
    return Scales(wrong, undecided)


def bend_of(
    said: Mapping[str, tuple[Floats, Floats]], inverse_depth: float, least: float
) -> Bend | None:
    """How a robot's depths bend, where its partners agree that they do.

    Args:
        said: by partner, bend (3,) and its covariance (3, 3), 1/m.
        inverse_depth: median of the robot's views, 1/m.
        least: smaller bends are no finding, share of the inverse depth.
    """
    if len(said) < 2:
        return None
    values = np.array([value for value, _ in said.values()])
    floor = (_BEND_SCATTER * inverse_depth) ** 2 * np.eye(3)
    information = np.linalg.inv([covariance + floor for _, covariance in said.values()])
    # robustly, from the surest partner on: a pair may have matched two copies of one thing
    value = values[np.linalg.det(information).argmax()]
    for _ in range(_ROUNDS):
        weight = _weights(values - value, information)
        total = np.einsum("p,pkl->kl", weight, information)
        value = np.linalg.solve(total, np.einsum("p,pkl,pl->k", weight, information, values))
    off = values - value
    weight = _weights(off, information)
    sigma = np.sqrt(np.diag(np.linalg.inv(np.einsum("p,pkl->kl", weight, information))))
    stated = np.sqrt([np.diag(covariance + floor) for _, covariance in said.values()])
    sigma = sigma * np.maximum(1.0, _MAD_SIGMA * np.median(np.abs(off) / stated, axis=0))
    agree = int((weight > 0.25).sum())
    clear = np.where(np.abs(value) > _SIGMAS * sigma, value, 0.0)
    if agree < 2 or 2 * agree <= len(values) or _over_image(clear) < least * inverse_depth:
        return None
    return Bend(value, sigma, agree)


def time_offset(scales: Floats, sigmas: Floats, rates: Floats) -> Estimate | None:
    """How much later than its image a robot's depths are measured, seconds.

    A robot that approaches what it sees measures depths that are too short by its rate times the
    offset; a wrong baseline does not depend on the rate.

    Args:
        scales: (M,) logs of how much too long its depths were, with sigmas (M,).
        rates: (M,) by what share of the depth it went forward in a second then.

    Returns:
        The offset where it is clearly not zero.
    """
    if len(scales) < _LEAST_MEASURED:
        return None
    sigmas = np.hypot(sigmas, _SCALE_SCATTER)
    A = np.column_stack((np.ones(len(rates)), -rates))
    ridge = np.diag([0.0, 1e-9])  # robots that stand still tell nothing
    solution = np.zeros(2)
    for _ in range(_ROUNDS):
        off = (scales - A @ solution) / sigmas
        W = 1.0 / (1.0 + off**2 / _GEMAN_MCCLURE) ** 2 / sigmas**2
        solution = np.linalg.solve((A.T * W) @ A + ridge, (A.T * W) @ scales)
    off = (scales - A @ solution) / sigmas
    excess = max(1.0, _MAD_SIGMA * float(np.median(np.abs(off))))
    covariance = np.linalg.inv((A.T / sigmas**2) @ A + ridge)
    sigma = excess * float(np.sqrt(covariance[1, 1]))
    estimate = Estimate(float(solution[1]), sigma, len(scales))
    clear = abs(estimate.value) > LEAST_OFFSET_S and estimate.significance > _SIGMAS
    return estimate if clear else None


def _weights(off: Floats, information: Floats) -> Floats:
    """Geman-McClure weights (P,) of residuals (P, 3), which may exceed their noise."""
    distance = np.einsum("pk,pkl,pl->p", off, information, off)
    excess = max(1.0, float(np.median(distance)) / _MEDIAN_CHI2_3)
    return 1.0 / (1.0 + distance / (_GEMAN_MCCLURE * excess)) ** 2


def _is_off(estimate: Estimate) -> bool:
    return abs(estimate.value) > LEAST_SCALE and estimate.significance > _SIGMAS


def _of_pair(value: float, sigma: float) -> Estimate:
    return Estimate(value, float(np.hypot(sigma, _SCALE_SCATTER)), 1)


def _against_partners(
    robot: str, pairs: Mapping[RobotPair, tuple[float, float]]
) -> Estimate | None:
    """A robot's scale against all its partners, None with fewer than two."""
    said = [
        (value if robot == a else -value, sigma)
        for (a, b), (value, sigma) in pairs.items()
        if robot in (a, b)
    ]
    if len(said) < 2:
        return None
    values, sigmas = np.array(said).T
    value = _cautious_median(values)
    scatter = max(_MAD_SIGMA * float(np.median(np.abs(values - value))), _SCALE_SCATTER)
    share = _MEDIAN_SIGMA / np.sqrt(len(values))
    return Estimate(value, share * float(np.hypot(scatter, np.median(sigmas))), len(values))


def _cautious_median(values: Floats) -> float:
    """The median; of two middle values the one nearer to zero, and zero between different signs:
    one of two partners that is wrong itself must not make a robot suspect.
    """
    ordered = np.sort(values)
    low, high = ordered[(len(values) - 1) // 2], ordered[len(values) // 2]
    return 0.0 if low * high <= 0 else float(min(low, high, key=abs))


def _over_image(bend: Floats) -> float:
    """Root mean square over the image of (offset, slope in x, slope in y)."""
    return float(np.sqrt(bend[0] ** 2 + (bend[1] ** 2 + bend[2] ** 2) / 3))
