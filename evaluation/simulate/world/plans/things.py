"""Unique things that stand and hang about at random places: posters, doors of other colours, carts,
statues. None is like another.
"""

from collections.abc import Callable, Sequence

import numpy as np

from fleetpose.evaluation.simulate.world.build import Builder, regular
from fleetpose.evaluation.simulate.world.materials.colours import PAINTS
from fleetpose.evaluation.simulate.world.materials.paints import (
    bare,
    cloth,
    crate,
    pasted,
    printed,
    tiles,
)
from fleetpose.evaluation.simulate.world.materials.textures import Rng, Texture, noise, plain, wood
from fleetpose.evaluation.simulate.world.plans.plan import Front, placed, shifted
from fleetpose.evaluation.simulate.world.render import Quad

_HUNG_M = 0.04  # a thing that hangs stands out by so much
_SEED = 3  # of the draws that things are made by, beside the world's


def unique_things(
    fronts: Sequence[Front], count: int, clear_m: float, seed: int
) -> tuple[Quad, ...]:
    """So many things along fronts, by chance. With a larger count the former ones stay as they are.

    Args:
        fronts: what they hang on and stand before.
        count: how many.
        clear_m: depth of the strip before a front that is theirs.
        seed: of the world.
    """
    rngs = [np.random.default_rng((seed, _SEED, k)) for k in range(count)]
    return tuple(quad for rng in rngs for quad in _thing(rng, fronts, clear_m))


def _thing(rng: Rng, fronts: Sequence[Front], clear_m: float) -> list[Quad]:
    lengths = np.array([one.length_m for one in fronts])
    front = fronts[int(rng.choice(len(fronts), p=lengths / lengths.sum()))]
    kind = _KINDS[int(rng.integers(len(_KINDS)))]
    along_m = float(rng.uniform(0.0, front.length_m))
    b = Builder(rng)
    kind(b, front, clear_m)
    return placed(b.quads, front.T_world_front @ shifted(along_m))


def _poster(b: Builder, front: Front, clear_m: float) -> None:
    del clear_m
    width = float(b.rng.uniform(0.5, 1.2))
    height = width * float(b.rng.uniform(0.8, 1.5))
    foot = float(b.rng.uniform(0.3, max(front.height_m - height, 0.4)))
    x = -width / 2, width / 2
    b.box(x, (-_HUNG_M, 0.0), (foot, foot + height), printed(128.0))


def _door(b: Builder, front: Front, clear_m: float) -> None:
    del clear_m
    width, top = float(b.rng.uniform(0.8, 1.1)), min(2.05, front.height_m)
    b.box((-width / 2, width / 2), (-_HUNG_M, 0.0), (0.0, top), _painted)


def _painted(rng: Rng, width: float, height: float) -> Texture:
    """Planks in a colour of their own, with a patch of another."""
    rows, columns = max(round(height * 96), 4), max(round(width * 96), 4)
    first, second = (PAINTS[int(k)] for k in rng.integers(len(PAINTS), size=2))
    door = wood(rng, rows, columns, first, float(rng.uniform(8, 20)))
    low, high = np.sort(rng.uniform(0.1, 0.9, 2))
    patch = (
        slice(int(low * rows), int(high * rows) + 2),
        slice(columns // 5, columns - columns // 5),
    )
    door[patch] = plain(rows, columns, second)[patch]
    return door * (1 + 0.15 * noise(rng, rows, columns, 12, 3))[..., None]


def _cart(b: Builder, front: Front, clear_m: float) -> None:
    """A crate on feet, with goods in it and perhaps a roof of cloth."""
    del front
    width, depth = float(b.rng.uniform(0.6, 1.3)), min(0.6 * clear_m, 0.7)
    x, y = (-width / 2, width / 2), (-0.1 - depth, -0.1)
    b.box(x, y, (0.25, 0.75), crate(112.0))
    for left in (-0.4 * width, 0.3 * width):
        b.box((left, left + 0.1 * width), y, (0.0, 0.25), bare("wood"))
    goods = float(b.rng.uniform(0.2, 0.6))
    b.box((x[0] + 0.1, x[1] - 0.2), (y[0] + 0.1, y[1]), (0.75, 0.75 + goods), pasted(112.0))
    if b.rng.uniform() < 0.5:
        b.box(x, y, (1.6, 1.68), cloth(96.0))


def _statue(b: Builder, front: Front, clear_m: float) -> None:
    """Something upright of a few storeys, each turned its own way, on a foot."""
    del front
    reach = min(0.35 * clear_m, 0.45)
    place = (0.0, -reach - 0.05)
    z = float(b.rng.uniform(0.3, 0.7))
    b.prism(regular(4, reach, place, float(b.rng.uniform(0, 90))), (0.0, z), bare("stone", 112.0))
    for _ in range(int(b.rng.integers(2, 4))):
        top = z + float(b.rng.uniform(0.3, 0.7))
        radius = reach * float(b.rng.uniform(0.35, 0.8))
        outline = regular(int(b.rng.integers(3, 7)), radius, place, float(b.rng.uniform(0, 90)))
        b.prism(outline, (z, top), _painted if b.rng.uniform() < 0.5 else pasted(112.0))
        z = top
    cap = regular(6, reach * 0.6, place)
    b.spire(cap, (z, z + 0.3), tiles(PAINTS, 96.0))


_KINDS: tuple[Callable[[Builder, Front, float], None], ...] = (_poster, _door, _cart, _statue)
