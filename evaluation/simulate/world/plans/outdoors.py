"""Plans under the open sky that repeat: courtyards, a facade, a colonnade, a front like its own
mirror image.

Every part faces -y and is lit from its own left, whichever way it is turned afterwards, so that
light does not tell alike parts apart.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from fleetpose.evaluation.simulate.world.build import Builder, regular
from fleetpose.evaluation.simulate.world.materials.colours import RED_TILES, SLATE
from fleetpose.evaluation.simulate.world.materials.facades import Style
from fleetpose.evaluation.simulate.world.materials.paints import (
    bare,
    cloth,
    crate,
    dressed,
    paved,
    tiles,
)
from fleetpose.evaluation.simulate.world.materials.textures import Rng
from fleetpose.evaluation.simulate.world.plans.plan import (
    Front,
    Plan,
    Room,
    copies,
    front,
    front_at,
    mirrored,
    room,
    shifted,
    turned,
)
from fleetpose.evaluation.simulate.world.render import Quad

_MATERIALS = ("render", "brick", "stone", "grey")
_OUT_OF_SIGHT_M = 64.0  # along a facade: beyond, no camera of the plan's robots sees its end


def courtyard2(rng: Rng) -> Plan:
    """A courtyard twice as long as wide; half a turn changes nothing."""
    half = (float(rng.uniform(10.0, 12.0)), float(rng.uniform(6.5, 8.0)))
    b = Builder(rng)
    _wing(b, half[0], half[1])
    across = Builder(rng)
    _wing(across, half[1], half[0])
    quads = [*b.quads, *copies(across.quads, [turned(1, 4)])]
    ground = Builder(rng)
    ground.slab(
        np.array((0.0, half[1] / 2)),
        np.array((half[0], 0.0)),
        np.array((0.0, half[1] / 2)),
        0.0,
        paved(64.0),
    )
    _basin(ground, 2)
    fronts = (
        _inner_front(half[0], half[1]),
        front_at(_inner_front(half[1], half[0]), turned(1, 4)),
    )
    return _courtyard([*quads, *ground.quads], fronts, half, 2)


def courtyard4(rng: Rng) -> Plan:
    """A square courtyard with four alike wings; a quarter turn changes nothing."""
    half = float(rng.uniform(8.5, 10.5))
    b = Builder(rng)
    _wing(b, half, half)
    quarter = np.array((half / 2, 0.0)), np.array((0.0, half / 2))
    b.slab(np.full(2, half / 2), *quarter, 0.0, paved(64.0))
    _basin(b, 4)
    return _courtyard(b.quads, (_inner_front(half, half),), (half, half), 4)


def _courtyard(
    quads: Sequence[Quad], fronts: tuple[Front, ...], half: tuple[float, float], fold: int
) -> Plan:
    poses = [turned(k, fold) for k in range(fold)]
    basin = (0.0, 0.0, 1.4)
    return Plan(
        quads=tuple(copies(quads, poses)),
        fronts=tuple(front_at(one, T) for T in poses for one in fronts),
        rooms=(room((-half[0], -half[1]), half, (basin,)),),
        symmetries=tuple(poses[1:]),
        distance_m=(4.0, 1.6 * min(half)),
        bearing_deg=50.0,
        clear_m=1.8,
        baseline_m=0.3,
    )


def _inner_front(half_length: float, distance: float) -> Front:
    return front((-half_length + 1.5, distance - 0.6), (half_length - 1.5, distance - 0.6))


def _wing(b: Builder, half_length: float, distance: float) -> None:
    """A wing of a courtyard at y = distance: two storeys, a bay, a porch, benches and a roof. It is
    not its own mirror image.
    """
    cut = float(b.rng.uniform(-0.35, 0.1)) * half_length
    materials = b.rng.permutation(_MATERIALS)
    height = float(b.rng.uniform(5.2, 6.4))
    for (x0, x1), material in zip(
        ((-half_length, cut), (cut, half_length)), materials, strict=False
    ):
        style = Style(material, 2.6, (1.0, 1.5), posters=0.05, ivy=0.3)
        wall = np.array((x0, distance)), np.array((x1, distance))
        b.wall(*wall, (0.0, height), dressed(style, 64.0))
    bay = cut + 0.2 * half_length
    style = Style(materials[2], 2.6, (0.8, 1.5), posters=0.0, ivy=0.2, door=False)
    b.box((bay, bay + 2.4), (distance - 1.0, distance), (0.0, 4.4), dressed(style, 64.0))
    porch = -0.75 * half_length
    b.box((porch, porch + 2.0), (distance - 0.9, distance), (2.2, 2.6), bare("wood"))
    for x in (porch + 0.1, porch + 1.8):
        b.box((x, x + 0.14), (distance - 0.85, distance - 0.7), (0.0, 2.2), bare("stone"))
    for x in (bay - 2.3, bay + 3.2):
        b.box((x, x + 1.3), (distance - 1.1, distance - 0.7), (0.0, 0.45), crate())
    palette = (RED_TILES, SLATE)[int(b.rng.integers(2))]
    eaves = np.array((-half_length, distance)), np.array((half_length, distance))
    b.wall(*eaves, (height, height + 1.8), tiles(palette, 48.0), lean=1.8)


def _basin(b: Builder, fold: int) -> None:
    """One of `fold` alike parts of a basin with a pillar in its middle."""
    rim, pillar = regular(8, 1.4, turn_deg=11.0), regular(8, 0.35, turn_deg=11.0)
    for k in range(8 // fold):
        b.wall(rim[k], rim[k + 1], (0.0, 0.6), bare("stone"))
        b.wall(rim[k], rim[(k + 1) % 8], (0.6, 0.75), bare("grey"), lean=1.29, taper=1.0)
        b.wall(pillar[k], pillar[k + 1], (0.6, 2.3), bare("stone"))
        b.wall(pillar[k], pillar[k + 1], (2.3, 2.9), tiles(SLATE), lean=0.32, taper=1.0)


def facade(rng: Rng) -> Plan:
    """One long facade of equal windows; one window further all looks the same."""
    period = float(rng.uniform(2.2, 3.2))
    b = Builder(rng)
    bay(b, period, str(rng.choice(_MATERIALS)))
    strip(b, period)
    return _row(
        b, period, front((-11.0, -0.4), (11.0, -0.4)), room((-17.0, -13.0), (17.0, 0.0)), 4.5
    )


def bay(b: Builder, period: float, material: str) -> None:
    """One window upon the other beside a pilaster, with a sill, a balcony, a cornice."""
    floor, window = 2.5, (1.1, 1.6)
    style = Style(material, floor, window, posters=0.0, ivy=0.0, graffiti=0, door=False)
    wall = np.zeros(2), np.array((period, 0.0))
    b.wall(*wall, (0.0, 7.4), dressed(style))
    middle = period / 2
    b.box((-0.2, 0.2), (-0.25, 0.0), (0.4, 7.4), bare("stone"))
    b.box((middle - 0.65, middle + 0.65), (-0.3, 0.0), (0.52, 0.72), bare("grey"))
    b.box((middle - 0.75, middle + 0.75), (-0.6, 0.0), (2.6, 2.75), bare("stone"))
    b.box((middle - 0.75, middle + 0.75), (-0.6, -0.55), (2.75, 3.5), bare("wood"))
    b.box((0.0, period), (-0.15, 0.0), (0.0, 0.4), bare("grey"))
    b.box((0.0, period), (-0.45, 0.0), (7.4, 7.7), bare("stone"))


def colonnade(rng: Rng) -> Plan:
    """Equal columns in a row before a wall of equal niches."""
    period = float(rng.uniform(2.2, 2.9))
    b = Builder(rng)
    style = Style("render", 2.4, (0.8, 1.6), posters=0.0, ivy=0.0, graffiti=0, door=False)
    b.wall(np.array((0.0, 0.0)), np.array((period, 0.0)), (0.0, 4.2), dressed(style))
    b.box((period / 2 - 0.6, period / 2 + 0.6), (-0.45, 0.0), (0.0, 0.5), bare("stone"))
    foot, shaft = regular(8, 0.42, (0.0, -2.6), 22.5), regular(8, 0.3, (0.0, -2.6), 22.5)
    b.prism(foot, (0.0, 0.35), bare("grey"))
    b.prism(shaft, (0.35, 3.6), bare("stone"))
    b.prism(regular(8, 0.45, (0.0, -2.6), 22.5), (3.6, 4.0), bare("grey"))
    b.box((0.0, period), (-3.0, -2.2), (4.0, 4.7), bare("stone"))
    b.ceiling(
        np.array((period / 2, -1.1)),
        np.array((period / 2, 0.0)),
        np.array((0.0, 1.1)),
        4.2,
        bare("wood"),
    )
    strip(b, period)
    return _row(
        b, period, front((-11.0, -2.4), (11.0, -2.4)), room((-17.0, -13.0), (17.0, -2.0)), 3.5
    )


def strip(b: Builder, period: float) -> None:
    """The ground before one period."""
    middle, along = np.array((period / 2, -7.0)), np.array((period / 2, 0.0))
    b.slab(middle, along, np.array((0.0, 7.0)), 0.0, paved(64.0))


def _row(b: Builder, period: float, seen: Front, where: Room, nearest_m: float) -> Plan:
    """One period again and again, as far as cameras see."""
    periods = int(np.ceil(_OUT_OF_SIGHT_M / period))
    return Plan(
        quads=tuple(copies(b.quads, [shifted(k * period) for k in range(-periods, periods)])),
        fronts=(seen,),
        rooms=(where,),
        symmetries=tuple(shifted(k * period) for k in (-3, -2, -1, 1, 2, 3)),
        distance_m=(nearest_m, 9.0),
        bearing_deg=42.0,
        clear_m=1.5,
        baseline_m=0.35,
    )


def mirror(rng: Rng) -> Plan:
    """A building front that is its own mirror image, with a court before it."""
    b = Builder(rng)
    _half_front(b, [str(m) for m in rng.permutation(_MATERIALS)])
    for x, y in itertools.product((4.0, 12.0), (-3.5, -10.5)):
        b.slab(np.array((x, y)), np.array((4.0, 0.0)), np.array((0.0, 3.5)), 0.0, paved(64.0))
    far = np.array((28.0, -6.85)), np.array((12.0, 0.0)), np.array((0.0, 7.15))
    b.slab(*far, 0.0, paved(32.0))
    fronts = (front((1.0, -1.6), (8.0, -1.0)), front((-8.0, -1.0), (-1.0, -1.6)))
    return Plan(
        quads=tuple(copies(b.quads, [np.eye(4), mirrored()])),
        fronts=fronts,
        rooms=(room((-14.0, -13.0), (14.0, 0.0)),),
        symmetries=(mirrored(),),
        distance_m=(4.5, 10.0),
        bearing_deg=45.0,
        clear_m=2.0,
        baseline_m=0.35,
    )


def _half_front(b: Builder, materials: Sequence[str]) -> None:
    """The right half: of a portal with columns and steps, a wing, a pavilion, and a garden wall."""

    def wall(x: tuple[float, float], y: float, top: float, style: Style) -> None:
        b.wall(np.array((x[0], y)), np.array((x[1], y)), (0.0, top), dressed(style, 64.0))

    portal = Style(materials[0], 2.8, (0.8, 1.6), posters=0, ivy=0, graffiti=0, door=False)
    wing = Style(materials[1], 2.6, (1.0, 1.5), posters=0.1, ivy=0.5, graffiti=0, door=False)
    pavilion = Style(materials[2], 2.6, (0.9, 1.6), posters=0, ivy=0.3, graffiti=0, door=True)
    wall((0.0, 2.6), -1.2, 7.0, portal)
    b.wall(np.array((2.6, -1.2)), np.array((2.6, 0.0)), (0.0, 7.0), bare("stone", 64.0))
    wall((2.6, 8.4), 0.0, 5.6, wing)
    b.box((8.4, 11.2), (-0.9, 2.0), (0.0, 6.4), dressed(pavilion, 64.0))
    wall((11.2, 40.0), 0.3, 2.4, Style("brick", windows=False, posters=0.05, door=False))
    b.box((0.0, 1.3), (-1.8, -1.2), (0.0, 0.2), bare("grey"))
    b.prism(regular(8, 0.22, (1.7, -1.7), 22.5), (0.0, 3.2), bare("stone"))
    b.box((0.0, 2.1), (-2.0, -1.2), (3.2, 3.6), bare("stone"))
    b.box((0.0, 0.7), (-1.3, -1.2), (0.0, 2.3), crate())
    b.box((4.0, 5.4), (-0.8, -0.4), (0.0, 0.45), crate())
    b.box((6.2, 7.8), (-0.9, 0.0), (2.4, 2.5), cloth())
    slate = tiles(SLATE, 48.0)
    b.wall(np.array((0.0, -1.2)), np.array((2.6, -1.2)), (7.0, 8.6), slate, lean=1.6)
    b.wall(np.array((2.6, 0.0)), np.array((8.4, 0.0)), (5.6, 7.2), slate, lean=1.6)


OUTDOORS: dict[str, Callable[[Rng], Plan]] = {
    "courtyard2": courtyard2,
    "courtyard4": courtyard4,
    "colonnade": colonnade,
    "facade": facade,
    "mirror": mirror,
}
