"""Which views of a recording make a ring of robots at a regular separation.

Where the recording tells each view's place on its ring, robots stand at regular angles, each at the
view nearest to its place. Elsewhere views are put in order along the path, by their azimuth around
the point that the cameras look at; every k-th is a robot, and the separation is the mean angle
between neighbours' optical axes.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fleetpose.evaluation.data.recording import Recording, TrueView, are_partners
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import optical_angle_deg
from fleetpose.protocol.errors import DataFolderError

WIDEST_DEG = 46.5
"""The paper's rings go to 45 degrees; steps of 7.66 degrees meet that at 46."""
_TOLERANCE = 0.3
"""How far two neighbours may be from the ring's separation, share of it."""


@dataclass(frozen=True)
class Ring:
    """Robots at a regular separation.

    Attributes:
        separation_deg: between neighbours, on the ring.
        views: one per robot, in ring order.
        pairs: true neighbours, i before j in the recording; stereo partners are left out.
    """

    separation_deg: float
    views: tuple[TrueView, ...]
    pairs: tuple[tuple[TrueView, TrueView], ...]


def rings_of(recording: Recording, starts: int = 1) -> list[list[Ring]]:
    """All rings of a recording, by separation, the smallest first.

    Args:
        recording: posed views.
        starts: rings per separation, at most, their first robots at different places.

    Raises:
        DataFolderError: it is no ring of posed views, or the views are too far apart.
    """
    if recording.is_rgbd:
        raise DataFolderError(
            f"{recording.directory} is a walk with a depth camera, no ring of posed views; "
            "`pose-eval persist` takes such recordings"
        )
    views = recording.usable
    if all(view.ring_angle_deg is not None for view in views):
        found = [_at_regular_angles(views, s, starts) for s in _separations_deg(views)]
    else:
        path = along_path(views)
        found = [_every_kth(path, k, starts) for k in range(1, len(path) // 2)]
        found = [rings for rings in found if rings and rings[0].separation_deg <= WIDEST_DEG]
    if not any(found):
        raise DataFolderError(
            f"{recording.directory}: no two neighbouring views are within {WIDEST_DEG:g} deg "
            "and not each other's stereo partner"
        )
    return [rings for rings in found if rings]


def along_path(views: Sequence[TrueView]) -> list[TrueView]:
    """Views by their azimuth around the point that they look at, beginning at the widest gap."""
    T_world_cameras = [view.T_world_camera for view in views]
    arms = np.array([T[:3, 3] for T in T_world_cameras]) - looked_at(T_world_cameras)
    across = np.linalg.svd(arms)[2]  # two directions in the cameras' plane, then its normal
    azimuths = np.arctan2(arms @ across[1], arms @ across[0])
    order = np.argsort(azimuths)
    gaps = np.diff(azimuths[order], append=azimuths[order[0]] + 2 * np.pi)
    return [views[k] for k in np.roll(order, -1 - int(gaps.argmax()))]


def looked_at(T_world_cameras: Sequence[Floats]) -> Floats:
    """(3,) the point nearest to all optical axes, world, metres."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for T in T_world_cameras:
        across = np.eye(3) - np.outer(T[:3, 2], T[:3, 2])
        A += across
        b += across @ T[:3, 3]
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], np.float64)


def _separations_deg(views: Sequence[TrueView]) -> list[float]:
    """Every multiple of the views' own step that a ring can have."""
    angles = np.sort(np.array([view.ring_angle_deg for view in views], np.float64))
    step = float(np.median(np.diff(angles))) if len(angles) > 1 else np.inf
    return [k * step for k in range(1, int(WIDEST_DEG / max(step, 1.0)) + 1)]


def _at_regular_angles(views: Sequence[TrueView], separation_deg: float, starts: int) -> list[Ring]:
    angles = {view.index: view.ring_angle_deg or 0.0 for view in views}
    by_index = {view.index: view for view in views}
    found: dict[tuple[int, ...], Ring] = {}
    for k in range(starts):
        first = min(angles.values()) + k * separation_deg / starts
        places = _places(angles, first, separation_deg)
        chosen = tuple(places.values())
        if chosen and chosen not in found:
            pairs = _neighbours(places, angles, separation_deg)
            found[chosen] = _ring(separation_deg, by_index, chosen, pairs)
    return [ring for ring in found.values() if ring.pairs]


def _every_kth(path: Sequence[TrueView], k: int, starts: int) -> list[Ring]:
    by_index = {view.index: view for view in path}
    lines = [[view.index for view in path[first::k]] for first in range(min(k, starts))]
    links = [[(min(p), max(p)) for p in itertools.pairwise(line)] for line in lines]
    angles = [
        optical_angle_deg(by_index[a].T_world_camera, by_index[b].T_world_camera)
        for pairs in links
        for a, b in pairs
    ]
    separation = float(np.mean(angles))
    rings = [
        _ring(separation, by_index, line, pairs) for line, pairs in zip(lines, links, strict=True)
    ]
    return [ring for ring in rings if ring.pairs]


def _ring(
    separation_deg: float,
    views: dict[int, TrueView],
    chosen: Sequence[int],
    pairs: Sequence[tuple[int, int]],
) -> Ring:
    both = [(views[a], views[b]) for a, b in pairs]
    kept = tuple(pair for pair in both if not are_partners(*pair))
    return Ring(separation_deg, tuple(views[v] for v in chosen), kept)


def _places(angles: dict[int, float], first: float, separation: float) -> dict[int, int]:
    """The view nearest to each place of a ring, where one is near enough."""
    last = max(angles.values())
    places: dict[int, int] = {}
    number = 0
    while first + number * separation <= min(last + 0.5 * separation, first + 360 - 1e-6):
        target = first + number * separation
        nearest = min(angles, key=lambda view: (_apart(angles[view], target), view))
        if (
            _apart(angles[nearest], target) < 0.5 * _TOLERANCE * separation
            and nearest not in places.values()
        ):
            places[number] = nearest
        number += 1
    return places


def _neighbours(
    places: dict[int, int], angles: dict[int, float], separation: float
) -> list[tuple[int, int]]:
    """Neighbours, the last and the first where the ring closes; the smaller index first."""
    last = max(places)
    closes = (
        0 in places
        and _apart(angles[places[last]] + separation, angles[places[0]]) < _TOLERANCE * separation
    )
    follows = [(k, k + 1) for k in range(last)] + ([(last, 0)] if closes and last > 1 else [])
    both = [(places[a], places[b]) for a, b in follows if a in places and b in places]
    return [(min(pair), max(pair)) for pair in both]


def _apart(a: float, b: float) -> float:
    """Degrees between two directions."""
    return abs((a - b + 180.0) % 360.0 - 180.0)
