"""What a plan of the world is: surfaces, where robots may stand, what they look at, and what is
alike.

World frame as in `build`: z up, the ground at z = 0; metres. A plan is made of a few parts that are
painted once and placed several times, so that alike places are alike to the last texel.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetpose.evaluation.simulate.world.render import Floats, Quad


@dataclass(frozen=True)
class Front:
    """An upright surface that robots look at, and along which unique things stand and hang.

    Attributes:
        a, b: (2,) its ends on the ground, left to right as seen by who looks at it.
        height_m: up to where things may hang.
    """

    a: Floats
    b: Floats
    height_m: float = 3.0

    @property
    def length_m(self) -> float:
        return float(np.linalg.norm(self.b - self.a))

    @property
    def T_world_front(self) -> Floats:
        """(4, 4) pose of the frame at `a`: x along the front, y into the wall, z up."""
        x, y = (self.b - self.a) / self.length_m
        T = np.eye(4)
        T[:2, :2] = ((x, -y), (y, x))
        T[:2, 3] = self.a
        return T

    def place(self, along_m: float, off_m: float) -> Floats:
        """(2,) a place on the ground `off_m` before the front."""
        return (self.T_world_front @ (along_m, -off_m, 0.0, 1.0))[:2]


@dataclass(frozen=True)
class Room:
    """A rectangle on the ground in which robots stand and see each other's surroundings.

    Attributes:
        low, high: (2,) its corners.
        pillars: (N, 3) x, y and radius of what stands in it.
    """

    low: Floats
    high: Floats
    pillars: Floats

    def holds(self, place: Floats, clear_m: float = 0.0) -> bool:
        """Whether a place (2,) is in the room, so far from its edges and from all pillars."""
        inside = (place >= self.low + clear_m - 1e-9) & (place <= self.high - clear_m + 1e-9)
        gaps = np.linalg.norm(self.pillars[:, :2] - place, axis=1) - self.pillars[:, 2]
        return bool(inside.all() and (gaps > clear_m).all())


@dataclass(frozen=True)
class Plan:
    """A place, and how robots look at it.

    Attributes:
        quads: all surfaces.
        fronts: what robots look at.
        rooms: where they stand.
        symmetries: (4, 4) isometries of the world, also improper ones, that change nothing as long
            as no unique things stand about and no end of the world is seen.
        distance_m: nearest and farthest distance of a robot from the place it looks at.
        bearing_deg: how far from the front's normal robots stand, at most.
        clear_m: distance that robots keep from walls and pillars; things stand nearer than that.
        baseline_m: of the robots' stereo rigs: about 5 % of the usual depth.
    """

    quads: tuple[Quad, ...]
    fronts: tuple[Front, ...]
    rooms: tuple[Room, ...]
    symmetries: tuple[Floats, ...]
    distance_m: tuple[float, float]
    bearing_deg: float
    clear_m: float
    baseline_m: float


def room(
    low: Sequence[float], high: Sequence[float], pillars: Sequence[Sequence[float]] = ()
) -> Room:
    """A room from plain numbers."""
    around = np.array(pillars, np.float64).reshape(-1, 3)
    return Room(np.array(low, np.float64), np.array(high, np.float64), around)


def front(a: Sequence[float], b: Sequence[float], height_m: float = 3.0) -> Front:
    """A front from plain numbers."""
    return Front(np.array(a, np.float64), np.array(b, np.float64), height_m)


def shifted(x_m: float, y_m: float = 0.0) -> Floats:
    """(4, 4) a step on the ground."""
    T = np.eye(4)
    T[:2, 3] = x_m, y_m
    return T


def turned(turn: int, of: int) -> Floats:
    """(4, 4) so many of `of` equal parts of a turn about the z axis, exact for quarter turns."""
    c, s = np.cos(2 * np.pi * turn / of), np.sin(2 * np.pi * turn / of)
    T = np.eye(4)
    T[:2, :2] = np.round(((c, -s), (s, c)), 15)
    return T


def mirrored() -> Floats:
    """(4, 4) left and right exchanged: x becomes -x."""
    return np.diag((-1.0, 1.0, 1.0, 1.0))


def placed(quads: Iterable[Quad], T: Floats) -> list[Quad]:
    """The same surfaces elsewhere; an improper isometry mirrors their textures as well."""
    return [_placed(quad, T) for quad in quads]


def _placed(quad: Quad, T: Floats) -> Quad:
    R = T[:3, :3]
    if np.linalg.det(R) > 0:
        corner = R @ quad.corner + T[:3, 3]
        return replace(quad, corner=corner, right=R @ quad.right, down=R @ quad.down)
    return replace(
        quad,
        corner=R @ (quad.corner + quad.right) + T[:3, 3],
        right=-R @ quad.right,
        down=R @ quad.down,
        texture=np.ascontiguousarray(quad.texture[:, ::-1]),
    )


def copies(quads: Sequence[Quad], poses: Iterable[Floats]) -> list[Quad]:
    """Surfaces placed several times; copies share their textures."""
    return [quad for T in poses for quad in placed(quads, T)]


def front_at(one: Front, T: Floats) -> Front:
    """A front moved by an isometry; left stays left for who looks at it."""
    a, b = (np.append(end, (0.0, 1.0)) @ T.T for end in (one.a, one.b))
    if np.linalg.det(T[:3, :3]) < 0:
        a, b = b, a
    return Front(a[:2], b[:2], one.height_m)


def room_at(one: Room, T: Floats) -> Room:
    """A room moved by an isometry that keeps its sides along the axes."""
    corners = np.array([T[:2, :2] @ end + T[:2, 3] for end in (one.low, one.high)])
    pillars = one.pillars.copy()
    pillars[:, :2] = one.pillars[:, :2] @ T[:2, :2].T + T[:2, 3]
    return Room(corners.min(0), corners.max(0), pillars)
