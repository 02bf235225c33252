"""Plans under a roof: a corridor of equal doors, two equal halls, a room of weak texture."""

from collections.abc import Callable, Sequence

import numpy as np

from fleetpose.evaluation.simulate.world.build import Builder, Paint, regular
from fleetpose.evaluation.simulate.world.materials.facades import Style
from fleetpose.evaluation.simulate.world.materials.paints import bare, crate, dressed, faint, pasted
from fleetpose.evaluation.simulate.world.materials.textures import Colour, Rng
from fleetpose.evaluation.simulate.world.plans.plan import (
    Plan,
    copies,
    front,
    front_at,
    room,
    room_at,
    shifted,
    turned,
)
from fleetpose.evaluation.simulate.world.render import Quad

_CORRIDOR_HALF_M = 40.0
_APART_M = 60.0  # two halls that have nothing to do with each other
_NO_WINDOWS = {"windows": False, "posters": 0.0, "ivy": 0.0, "graffiti": 0}


def corridor(rng: Rng) -> Plan:
    """A corridor of equal doors; one door further and from the other side all looks the same."""
    period, half = float(rng.uniform(1.8, 2.4)), float(rng.uniform(1.6, 2.0))
    b = Builder(rng)
    _doorway(b, period, half)
    cell = copies(b.quads, [turned(0, 2), turned(1, 2)])
    periods = int(_CORRIDOR_HALF_M / period)
    end = (periods + 0.5) * period
    dark = Builder(rng)
    dark.wall(np.array((end, half)), np.array((end, -half)), (0.0, 2.6), bare("grey", 32.0))
    quads = [
        *copies(cell, [shifted(k * period) for k in range(-periods, periods + 1)]),
        *copies(dark.quads, [turned(0, 2), turned(1, 2)]),
    ]
    side = front((-6.0, half - 0.15), (6.0, half - 0.15), 2.3)
    steps = [shifted(k * period) for k in (-3, -2, -1, 0, 1, 2, 3)]
    same = [step @ turned(k, 2) for step in steps for k in range(2)]
    return Plan(
        quads=tuple(quads),
        fronts=(side, front_at(side, turned(1, 2))),
        rooms=(room((-10.0, -half), (10.0, half)),),
        symmetries=tuple(T for T in same if not np.allclose(T, np.eye(4))),
        distance_m=(1.2, 4.5),
        bearing_deg=70.0,
        clear_m=0.8,
        baseline_m=0.12,
    )


def _doorway(b: Builder, period: float, half: float) -> None:
    """One period of the left side, with its half of floor and ceiling, around x = 0."""
    style = Style(str(b.rng.choice(("render", "wood", "brick"))), door=True, **_NO_WINDOWS)
    x = period / 2
    b.wall(np.array((-x, half)), np.array((x, half)), (0.0, 2.6), dressed(style, 160.0, 1.4))
    for left in (-0.66, 0.58):
        b.box((left, left + 0.08), (half - 0.1, half), (0.0, 2.1), bare("wood", 160.0))
    b.box((-0.66, 0.66), (half - 0.1, half), (2.1, 2.2), bare("wood", 160.0))
    b.box((x - 0.12, x + 0.12), (half - 0.14, half), (0.0, 2.6), bare("stone", 160.0))
    b.box((0.75, x), (half - 0.05, half), (0.0, 0.15), bare("wood", 160.0))
    b.box((-0.4, 0.4), (0.2, 0.35), (2.5, 2.6), bare("grey"))
    middle, along, across = np.array((0.0, half / 2)), np.array((x, 0.0)), np.array((0.0, half / 2))
    b.slab(middle, along, across, 0.0, bare("stone", 128.0))
    b.ceiling(middle, along, across, 2.6, bare("wood", 96.0))


def halls(rng: Rng) -> Plan:
    """Two equal halls with a passage between them; half a turn about its middle exchanges them."""
    half, gap = (float(rng.uniform(5.5, 6.5)), float(rng.uniform(4.0, 5.0))), 3.0
    b = Builder(rng)
    _hall(b, half, open_width=2.4)
    passage = Builder(rng)
    _passage(passage, gap / 2, 1.2)
    return _two_halls(b.quads, half, half[0] + gap / 2, passage.quads)


def halls_apart(rng: Rng) -> Plan:
    """Two equal halls far from each other, with nothing between them."""
    half = (float(rng.uniform(5.5, 6.5)), float(rng.uniform(4.0, 5.0)))
    b = Builder(rng)
    _hall(b, half, open_width=0.0)
    return _two_halls(b.quads, half, _APART_M / 2, [])


def _two_halls(
    hall: Sequence[Quad], half: tuple[float, float], aside_m: float, between: Sequence[Quad]
) -> Plan:
    """A hall beside the origin, and another where half a turn about it leads; robots in both."""
    poses = (shifted(-aside_m), turned(1, 2) @ shifted(-aside_m))
    x, y = half
    sides = (
        front((-x + 0.5, y - 0.3), (x - 0.5, y - 0.3)),
        front((x - 0.5, -y + 0.3), (-x + 0.5, -y + 0.3)),
        front((-x + 0.3, -y + 0.5), (-x + 0.3, y - 0.5)),
    )
    inside = room((-x, -y), (x, y), _pillars(half))
    return Plan(
        quads=(*copies(hall, poses), *copies(between, [np.eye(4), turned(1, 2)])),
        fronts=tuple(front_at(side, T) for T in poses for side in sides),
        rooms=tuple(room_at(inside, T) for T in poses),
        symmetries=(turned(1, 2),),
        distance_m=(2.5, 8.0),
        bearing_deg=55.0,
        clear_m=1.2,
        baseline_m=0.2,
    )


def _pillars(half: tuple[float, float]) -> Sequence[Sequence[float]]:
    return [(-half[0] / 3, half[1] / 3, 0.3), (half[0] / 3, -half[1] / 4, 0.3)]


def _hall(b: Builder, half: tuple[float, float], open_width: float) -> None:
    """A hall around the origin; its east wall has an opening of so many metres, or none."""
    x, y = half
    height = 4.0
    corners = [np.array(p) for p in ((-x, -y), (-x, y), (x, y), (x, -y))]
    looks = [
        Style(str(m), 2.6, (0.9, 1.5), posters=0.1, ivy=0.0, graffiti=0)
        for m in b.rng.permutation(("render", "brick", "stone", "wood"))
    ]
    for k in (0, 1, 3):  # west, north, south, each left to right as seen from inside
        b.wall(corners[k], corners[(k + 1) % 4], (0.0, height), dressed(looks[k], 96.0, 1.3))
    _east(b, half, height, open_width, dressed(looks[2], 96.0))
    for px, py, r in _pillars(half):
        b.prism(regular(8, r, (px, py), 22.5), (0.0, height), bare("stone"))
    b.box((-x, -x + 1.0), (-y + 1.0, -y + 3.0), (0.0, 1.0), crate())
    b.box((-x / 2, -x / 2 + 2.2), (y - 0.8, y), (0.0, 0.9), bare("wood"))
    b.box((x / 2, x / 2 + 0.8), (-y, -y + 0.8), (0.0, 1.7), crate())
    b.box((-0.5, 0.9), (-y, -y + 0.25), (1.0, 2.4), pasted())
    along, across = np.array((x, 0.0)), np.array((0.0, y))
    b.slab(np.zeros(2), along, across, 0.0, bare("stone", 64.0))
    b.ceiling(np.zeros(2), along, across, height, bare("wood", 48.0))


def _east(b: Builder, half: tuple[float, float], top: float, width: float, paint: Paint) -> None:
    x, y = half
    edge = width / 2
    if not width:
        b.wall(np.array((x, y)), np.array((x, -y)), (0.0, top), paint)
        return
    b.wall(np.array((x, y)), np.array((x, edge)), (0.0, top), paint)
    b.wall(np.array((x, -edge)), np.array((x, -y)), (0.0, top), paint)
    b.wall(np.array((x, edge)), np.array((x, -edge)), (2.6, top), paint)


def _passage(b: Builder, length: float, half_width: float) -> None:
    """The half of a passage at -x, without the other half that a half turn makes of it."""
    x, y = -length, half_width
    b.wall(np.array((x, y)), np.array((0.0, y)), (0.0, 2.6), bare("brick"))
    b.wall(np.array((0.0, -y)), np.array((x, -y)), (0.0, 2.6), bare("brick"))
    middle, along, across = np.array((x / 2, 0.0)), np.array((length / 2, 0.0)), np.array((0.0, y))
    b.slab(middle, along, across, 0.0, bare("stone", 64.0))
    b.ceiling(middle, along, across, 2.6, bare("wood", 64.0))


def weak(rng: Rng) -> Plan:
    """A room of evenly painted walls with a door, a window and little furniture."""
    x, y, height = float(rng.uniform(4.0, 4.8)), float(rng.uniform(3.2, 3.8)), 2.8
    tones: list[Colour] = [(g, g * 1.02, g * 1.05) for g in rng.uniform(150, 205, 6)]
    strength = float(rng.uniform(0.6, 1.4))
    b = Builder(rng)
    corners = [np.array(p) for p in ((-x, -y), (-x, y), (x, y), (x, -y))]
    for k in range(4):
        b.wall(corners[k], corners[(k + 1) % 4], (0.0, height), faint(tones[k], strength))
    along, across = np.array((x, 0.0)), np.array((0.0, y))
    b.slab(np.zeros(2), along, across, 0.0, faint((120, 130, 140), strength))
    b.ceiling(np.zeros(2), along, across, height, faint((215, 218, 220), strength))
    b.box((-1.2, -0.3), (y - 0.05, y), (0.0, 2.05), faint((105, 120, 140), strength))
    b.box((0.8, 2.4), (y - 0.05, y), (0.9, 2.1), faint((225, 220, 205), strength))
    b.box((-x, -x + 0.5), (-1.0, 0.8), (0.0, 1.9), faint(tones[4], strength))
    b.box((1.0, 2.6), (-y, -y + 0.7), (0.0, 0.75), faint(tones[5], strength))
    b.box((-0.4, -0.2), (y - 0.03, y), (1.0, 1.25), faint(tones[5], strength))
    b.box((-3.0, -1.5), (-y, -y + 0.05), (1.2, 2.2), faint((160, 150, 130), 2 * strength))
    b.box((x - 0.12, x), (-1.6, -0.4), (0.2, 0.8), faint((190, 195, 200), strength))
    sides = (
        front((-x + 0.4, y - 0.1), (x - 0.4, y - 0.1), 2.4),
        front((x - 0.15, y - 0.4), (x - 0.15, -y + 0.4), 2.4),
        front((x - 0.4, -y + 0.1), (-x + 0.4, -y + 0.1), 2.4),
        front((-x + 0.1, -y + 0.4), (-x + 0.1, y - 0.4), 2.4),
    )
    return Plan(
        quads=tuple(b.quads),
        fronts=sides,
        rooms=(room((-x, -y), (x, y)),),
        symmetries=(),
        distance_m=(2.0, 6.0),
        bearing_deg=55.0,
        clear_m=1.2,
        baseline_m=0.15,
    )


INDOORS: dict[str, Callable[[Rng], Plan]] = {
    "corridor": corridor,
    "halls": halls,
    "halls_apart": halls_apart,
    "weak": weak,
}
