"""Clicks that deceive: all of them wrong, and yet they fit each other.

A person takes the next window for this one, and does so with every point; or knows the four corners
of a window, and clicks them in another order.
"""

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.clicks.click_noise import Clicked, Lift
from fleetpose.evaluation.data.opening import points_of
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.metrics.geometry import Floats, transform
from fleetpose.evaluation.simulate.operator import CLICK_SIGMA_PX, far_apart

_TRIED_PER_CLICK = 6
_SAME_DEPTH = 0.03  # of a point that was clicked: as far as the one that was meant, share
_POINTS = 4000
_CORNERS = 4
_FLAT_SHARE = 0.05  # of its size: a quadrilateral that is no flatter is none
_LEAST_EXTENT = 0.15  # of the image height, both ways


def one_step_along(
    recording: Recording,
    views: tuple[TrueView, TrueView],
    metres: float,
    count: int,
    rng: np.random.Generator,
    lift: Lift,
) -> Clicked | None:
    """Clicks that are all one step along the surface off, in the second view: every point that was
    picked in the first is sought `metres` beside where it is, where the second view shows a surface
    as far away as it should be.

    Args:
        recording, views: with their truth.
        metres: the step, along the longest horizontal direction of what the first view sees.
        count: of the clicks.
        rng: of choice, side and noise.
        lift: what the server makes of a pixel of the first (0) or second (1) view.

    Returns:
        None where so many places cannot be found.
    """
    i, j = views
    uv_i, points = _recorded(recording, i)
    some = rng.permutation(len(points))[:_POINTS]
    uv_i, points = uv_i[some], points[some]
    step = metres * rng.choice((-1.0, 1.0)) * _along(points)
    there = transform(j.T_to(i), points + step)
    uvw = there @ j.K.T
    uv_j = uvw[:, :2] / np.where(there[:, 2:] > 0, uvw[:, 2:], np.nan)
    inside = (there[:, 2] > 0) & ((uv_j >= 0) & (uv_j <= (j.width - 1, j.height - 1))).all(axis=1)
    uv_i, uv_j, z = uv_i[inside], uv_j[inside], there[inside, 2]
    if len(uv_i) < count:
        return None
    taken: list[tuple[Floats, Floats]] = []
    for k in far_apart(uv_i, min(count * _TRIED_PER_CLICK * 4, len(uv_i)), rng):
        pixels = [_by_hand(uv[k], rng, view) for uv, view in ((uv_i, i), (uv_j, j))]
        lifted = [lift(side, pixel) for side, pixel in enumerate(pixels)]
        if any(point is None for point in lifted):
            continue
        if abs(_depth(lifted[1]) / z[k] - 1.0) > _SAME_DEPTH:
            continue
        taken.append((pixels[0], pixels[1]))
        if len(taken) == count:
            return _clicked(taken)
    return None


def corners_in_order(
    recording: Recording,
    views: tuple[TrueView, TrueView],
    true: tuple[Floats, Floats],
    rng: np.random.Generator,
    lift: Lift,
    tries: int = 400,
) -> Clicked | None:
    """Four points of one plane that both views see, clicked rightly; none where there are none.

    Args:
        recording, views: with their truth.
        true: (N, 2) pixels of both views that show the same points.
        rng: of choice and noise.
        lift: what the server makes of a pixel of the first (0) or second (1) view.
        tries: so many quadruples are looked at.
    """
    i, j = views
    uv, points = _recorded(recording, i)
    nearest = np.array([int(np.linalg.norm(uv - pixel, axis=1).argmin()) for pixel in true[0]])
    for _ in range(tries if len(nearest) >= _CORNERS else 0):
        four = rng.choice(len(nearest), _CORNERS, replace=False)
        spread = np.linalg.svd(points[nearest[four]] - points[nearest[four]].mean(axis=0))[1]
        wide = min(np.linalg.svd(p[four] - p[four].mean(axis=0))[1][1] for p in true)
        if spread[2] > _FLAT_SHARE * spread[0] or wide < _LEAST_EXTENT * min(i.height, j.height):
            continue
        pixels = [
            (_by_hand(true[0][k], rng, i), _by_hand(true[1][k], rng, j)) for k in four.tolist()
        ]
        if all(lift(side, p[side]) is not None for p in pixels for side in (0, 1)):
            return replace(_clicked(pixels), wrong=np.zeros(_CORNERS, bool))
    return None


def in_other_orders(clicked: Clicked) -> list[Clicked]:
    """The same pixels, those of the second view in every order but the right one."""
    orders = list(permutations(range(len(clicked))))[1:]
    return [
        Clicked(
            (clicked.pixels[0], clicked.pixels[1][list(order)]),
            np.array([k != m for k, m in enumerate(order)]),
        )
        for order in orders
    ]


def _recorded(recording: Recording, view: TrueView) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and points (N, 3) of a view, without the noise of its own cloud where there are
    points of several views.
    """
    sparse = recording.directory / "sparse" / Path(view.name).with_suffix(".npz").name
    return points_of(replace(view, cloud=sparse) if sparse.exists() else view)


def _along(points: Floats) -> Floats:
    """(3,) unit vector: the longest horizontal direction of points (N, 3) of an upright camera."""
    level = points[:, [0, 2]] - np.median(points[:, [0, 2]], axis=0)
    near = np.linalg.norm(level, axis=1)
    level = level[near < 3 * np.median(near)]
    along = np.linalg.svd(level, full_matrices=False)[2][0]
    return np.array([along[0], 0.0, along[1]])


def _by_hand(pixel: Floats, rng: np.random.Generator, view: TrueView) -> Floats:
    noisy = pixel + rng.normal(0.0, CLICK_SIGMA_PX, 2)
    return np.clip(noisy, 0.0, (view.width - 1.0, view.height - 1.0))


def _depth(lifted: object) -> float:
    return float(lifted.p[2])  # type: ignore[attr-defined]


def _clicked(taken: list[tuple[Floats, Floats]]) -> Clicked:
    pixels = np.array(taken, np.float64).reshape(-1, 2, 2)
    wrong: npt.NDArray[np.bool_] = np.ones(len(pixels), bool)
    return Clicked((pixels[:, 0], pixels[:, 1]), wrong)
