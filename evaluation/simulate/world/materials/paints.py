"""Ways to paint a surface: each makes the texture of a wall, a box or a roof from its size."""

from collections.abc import Sequence

from fleetpose.evaluation.simulate.world.build import Paint
from fleetpose.evaluation.simulate.world.materials import facades, textures
from fleetpose.evaluation.simulate.world.materials.facades import Style
from fleetpose.evaluation.simulate.world.materials.textures import Colour, Rng, Texture

WALL_PX_PER_M = 96.0
_FAINT_PX_PER_M = 80.0


def dressed(style: Style, px_per_m: float = WALL_PX_PER_M, scale: float = 1.0) -> Paint:
    """A facade; with `scale` all that is on it is so many times as large."""
    px = px_per_m * scale
    return lambda rng, width, height: facades.facade(rng, width / scale, height / scale, px, style)


def pasted(px_per_m: float = WALL_PX_PER_M) -> Paint:
    """Posters, layer on layer."""
    return lambda rng, width, height: facades.hoarding(rng, width, height, px_per_m)


def crate(px_per_m: float = WALL_PX_PER_M) -> Paint:
    """Boards with a word on them."""
    return lambda rng, width, height: facades.crate(rng, width, height, px_per_m)


def cloth(px_per_m: float = WALL_PX_PER_M) -> Paint:
    """Striped cloth."""
    return lambda rng, width, height: facades.awning(rng, width, height, px_per_m)


def tiles(palette: Sequence[Colour], px_per_m: float = WALL_PX_PER_M) -> Paint:
    """Roof tiles."""
    return lambda rng, width, height: textures.roof_tiles(
        rng, round(height * px_per_m), round(width * px_per_m), palette, 0.22 * px_per_m
    )


def bare(material: str, px_per_m: float = WALL_PX_PER_M) -> Paint:
    """A weathered wall of one material, nothing on it."""

    def paint(rng: Rng, width: float, height: float) -> Texture:
        size = max(round(height * px_per_m), 2), max(round(width * px_per_m), 2)
        return facades.weathered(rng, facades.wall_of(rng, *size, px_per_m, material), px_per_m)

    return paint


def paved(px_per_m: float = WALL_PX_PER_M) -> Paint:
    """Worn slabs with patches of cobble, stains and litter."""

    def paint(rng: Rng, width: float, height: float) -> Texture:
        rows, columns = round(height * px_per_m), round(width * px_per_m)
        return textures.paving(rng, max(rows, columns), 0.42 * px_per_m)[:rows, :columns]

    return paint


def printed(px_per_m: float = WALL_PX_PER_M) -> Paint:
    """One poster."""
    return lambda rng, width, height: facades.poster(
        rng, max(round(height * px_per_m), 8), max(round(width * px_per_m), 8)
    )


def faint(colour: Colour, strength: float = 1.0) -> Paint:
    """A wall painted evenly: clouds, grain and a few hair cracks of some grey levels."""
    px = _FAINT_PX_PER_M

    def paint(rng: Rng, width: float, height: float) -> Texture:
        rows, columns = max(round(height * px), 4), max(round(width * px), 4)
        wall = textures.plain(rows, columns, colour)
        wall = textures.modulated(wall, textures.noise(rng, rows, columns, px, 3), 0.02 * strength)
        for cell, share in ((0.25, 0.012), (0.06, 0.012)):
            grain = textures.noise(rng, rows, columns, cell * px, 3, 0.9)
            wall = textures.modulated(wall, grain, share * strength)
        aged = textures.cracked(rng, wall, int(rng.poisson(0.5 * width * height)))
        return wall + 0.25 * (aged - wall)

    return paint
