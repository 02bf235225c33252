"""The town square: a rotunda with annexes, stalls and columns around it, houses at the rim.

The rotunda's axis is the world's z axis. Everything on the square stays within 5.5 m of it or
beyond 12 m.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from fleetpose.evaluation.simulate.world.build import SUN, Builder, polar, rectangle, regular
from fleetpose.evaluation.simulate.world.materials import textures
from fleetpose.evaluation.simulate.world.materials.colours import COPPER, RED_TILES, SLATE
from fleetpose.evaluation.simulate.world.materials.facades import Style
from fleetpose.evaluation.simulate.world.materials.paints import (
    bare,
    cloth,
    crate,
    dressed,
    pasted,
    tiles,
)
from fleetpose.evaluation.simulate.world.materials.textures import Rng, Texture
from fleetpose.evaluation.simulate.world.render import Floats, Renderer

RIM_PX_PER_M = 32.0
GROUND_PX_PER_M = 60.0
GROUND_HALF_M = 17.0
RIM_APOTHEM_M = 16.0


def town_square(seed: int) -> Renderer:
    """The whole world, the same for the same seed."""
    rng = np.random.default_rng(seed)
    builder = Builder(rng)
    _rotunda(builder)
    _annexes(builder)
    _square(builder)
    _kiosks(builder)
    _rim(builder)
    _ground(builder)
    return Renderer(builder.quads, textures.sky(rng, 256, 1536))


def _rotunda(b: Builder) -> None:
    """An octagonal hall, a cornice, a narrower upper storey, and a copper roof with a lantern."""
    turn = 11.0
    hall, cornice = regular(8, 2.4, turn_deg=turn), regular(8, 2.6, turn_deg=turn)
    materials = ("stone", "brick", "render", "stone", "brick", "render", "stone", "render")
    for k, material in enumerate(materials):
        style = Style(material, posters=0.6, graffiti=1, ivy=0.4, door=k % 2 == 0)
        b.wall(hall[k], hall[(k + 1) % 8], (0.0, 3.2), dressed(style))
    b.shadows.append((hall, 3.2))
    b.prism(cornice, (3.2, 3.4), bare("stone"))
    b.soffit(cornice, 3.2, 0.25, bare("stone"))
    b.spire(cornice, (3.4, 3.7), tiles(RED_TILES), taper=0.25)
    small = Style("stone", 1.15, (0.35, 0.7), posters=0.0, graffiti=0, ivy=0.2, door=False)
    b.prism(regular(8, 1.95, turn_deg=turn), (3.4, 5.1), dressed(small))
    eaves = regular(8, 2.15, turn_deg=turn)
    b.prism(eaves, (5.1, 5.25), bare("grey"))
    b.soffit(eaves, 5.1, 0.25, bare("wood"))
    b.spire(eaves, (5.25, 6.5), tiles(COPPER), taper=0.8)
    tiny = Style("render", 0.9, (0.15, 0.5), posters=0.0, graffiti=0, ivy=0.0, door=False)
    b.prism(regular(8, 0.4, turn_deg=turn), (6.2, 7.0), dressed(tiny))
    b.spire(regular(8, 0.5, turn_deg=turn), (7.0, 8.0), tiles(COPPER))


def _annexes(b: Builder) -> None:
    """Houses and turrets that lean on the rotunda, each turned its own way."""
    for azimuth, turn, size, height, material, roof in (
        (34.0, 40.0, (1.1, 1.5), 1.9, "brick", RED_TILES),
        (118.0, 100.0, (1.1, 1.5), 2.2, "render", SLATE),
        (205.0, 222.0, (1.4, 1.3), 1.7, "wood", RED_TILES),
        (290.0, 280.0, (1.1, 1.8), 2.0, "render", SLATE),
    ):
        outline = rectangle(polar(2.6, azimuth), size, turn)
        style = Style(material, 1.6, (0.4, 0.65), posters=0.8, ivy=0.5)
        b.prism(outline, (0.0, height), dressed(style))
        b.gable(outline, (height, height + 0.55 * size[0]), tiles(roof), bare(material))
    for azimuth, height in ((165.0, 4.2),):
        place = polar(2.15, azimuth)
        style = Style("stone", 1.2, (0.2, 0.45), posters=0.4, ivy=0.4, door=False)
        b.prism(regular(6, 0.5, place, azimuth), (0.0, height), dressed(style))
        roof = regular(6, 0.6, place, azimuth)
        b.soffit(roof, height, 0.13, bare("wood"))
        b.spire(roof, (height, height + 1.0), tiles(SLATE))


def _square(b: Builder) -> None:
    """Advertising columns, stalls and crates around the rotunda, low enough to see over."""
    for azimuth in (358.0, 140.0, 246.0):
        place = polar(3.5, azimuth)
        b.prism(regular(8, 0.32, place), (0.0, 1.5), pasted())
        b.soffit(regular(8, 0.4, place), 1.5, 0.11, bare("wood"))
        b.spire(regular(8, 0.4, place), (1.5, 1.9), tiles(COPPER))
    for azimuth, turn in ((80.0, 95.0), (192.0, 180.0), (312.0, 335.0)):
        place = polar(4.4, azimuth)
        b.prism(rectangle(place, (0.5, 1.0), turn), (0.0, 0.65), crate(), top=bare("wood"))
        b.prism(rectangle(place, (0.14, 0.7), turn), (0.65, 1.2), pasted())
        b.gable(rectangle(place, (0.8, 1.15), turn), (1.15, 1.45), cloth(), cloth())
    boards = crate()
    for _ in range(24):
        size = b.rng.uniform(0.2, 0.45, 3)
        place = polar(b.rng.uniform(3.4, 5.0), b.rng.uniform(0, 360))
        outline = rectangle(place, (size[0], size[1]), b.rng.uniform(0, 90))
        b.prism(outline, (0.0, size[2]), boards, top=boards)


def _kiosks(b: Builder) -> None:
    """Kiosks behind the ring."""
    paints = (
        pasted(RIM_PX_PER_M),
        dressed(Style("render", floor_m=1.9, posters=0.6), RIM_PX_PER_M),
        dressed(Style("wood", floor_m=1.9), RIM_PX_PER_M),
    )
    stripes = cloth(RIM_PX_PER_M)
    for azimuth in np.arange(0, 360, 30.0) + b.rng.uniform(-9, 9, 12):
        place = polar(b.rng.uniform(12.8, 14.0), azimuth)
        size = b.rng.uniform((1.0, 1.2, 1.9), (1.8, 2.2, 2.8))
        outline = rectangle(place, (size[0], size[1]), azimuth + b.rng.uniform(-30, 30))
        b.prism(outline, (0.0, size[2]), paints[int(b.rng.integers(3))])
        b.gable(outline, (size[2], size[2] + 0.5), stripes, stripes)


def _rim(b: Builder) -> None:
    """A closed row of town houses of different heights, two on each side, facing the square."""
    sides = 16
    corners = regular(sides, RIM_APOTHEM_M / np.cos(np.pi / sides), turn_deg=5.0)
    materials = ("render", "brick", "stone", "render", "grey", "render", "brick")
    for k in range(sides):
        # as seen from the square, left is counter-clockwise
        a, c = corners[(k + 1) % sides], corners[k]
        middle = a + (c - a) * b.rng.uniform(0.38, 0.62)
        for left, right in ((a, middle), (middle, c)):
            material = materials[int(b.rng.integers(len(materials)))]
            height = float(b.rng.uniform(4.2, 7.2))
            style = Style(material, 1.9, (0.75, 1.1), posters=0.4)
            b.wall(left, right, (0.0, height), dressed(style, RIM_PX_PER_M))
            roof = tiles((RED_TILES, SLATE)[int(b.rng.integers(2))], RIM_PX_PER_M)
            b.wall(left, right, (height, height + 1.6), roof, lean=1.5)


def _ground(b: Builder) -> None:
    """The square's floor, darkened where something stands between it and the sun."""

    def paint(rng: Rng, width: float, height: float) -> Texture:
        size = round(width * GROUND_PX_PER_M)
        floor = textures.paving(rng, size, 0.42 * GROUND_PX_PER_M)
        return floor * _shade_of(b.shadows, size)[..., None]

    half = GROUND_HALF_M
    b.slab(np.zeros(2), np.array((half, 0.0)), np.array((0.0, half)), 0.0, paint)


def _shade_of(shadows: Sequence[tuple[Floats, float]], size: int) -> textures.Field:
    """Light (size, size) that reaches the ground: soft shadows, darkest at the foot of a wall."""
    dark = np.zeros((size, size), np.uint8)
    foot = np.zeros((size, size), np.uint8)
    for outline, height in shadows:
        fall = -SUN[:2] / SUN[2] * height
        swept = cv2.convexHull(_to_ground(np.concatenate((outline, outline + fall))))
        cv2.fillConvexPoly(dark, swept, 255, cv2.LINE_AA)
        cv2.fillConvexPoly(foot, _to_ground(outline), 255, cv2.LINE_AA)
    soft = cv2.GaussianBlur(dark, (0, 0), 0.05 * GROUND_PX_PER_M).astype(np.float32) / 255
    near = cv2.GaussianBlur(foot, (0, 0), 0.16 * GROUND_PX_PER_M).astype(np.float32) / 255
    return (1 - 0.42 * soft) * (1 - 0.45 * near)


def _to_ground(points: Floats) -> np.ndarray:
    """Texels of the ground's texture: its first row is at +y, its first column at -x."""
    texels = np.column_stack((points[:, 0] + GROUND_HALF_M, GROUND_HALF_M - points[:, 1]))
    return np.rint(texels * GROUND_PX_PER_M).astype(np.int32)
