"""Materials of the synthetic world: bricks, stone, plaster, wood, tiles, paving, sky. Made, never
loaded.

Every function takes a generator and a size in pixels and returns (H, W, 3) float32 BGR, 0 to 255.
Lengths are in pixels. The same generator state gives the same texture to the last bit.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

Texture = npt.NDArray[np.floating]
Canvas = npt.NDArray[Any]
Field = npt.NDArray[np.floating]
Colour = tuple[float, float, float]
Rng = np.random.Generator
T = TypeVar("T")
_SLABS = [(150, 158, 165), (138, 146, 158), (160, 164, 166)]
_COBBLES = [(105, 112, 122), (120, 124, 130), (95, 100, 112)]
_LITTER = [(40, 120, 200), (30, 80, 170), (60, 160, 190)]
_LITTER += [(200, 205, 210), (35, 45, 50), (70, 130, 80)]


def one_of(rng: Rng, choices: Sequence[T]) -> T:
    """Any of them."""
    return choices[int(rng.integers(len(choices)))]


def dot(image: Texture, at: Sequence[int], radius: int, colour: Sequence[float]) -> None:
    """Draws a filled circle."""
    cv2.circle(image, at, radius, colour, -1, cv2.LINE_AA)


def spot(
    image: Canvas, at: Sequence[int], axes: Sequence[int], turn: float, colour: Sequence[float]
) -> None:
    """Draws a filled ellipse, turned by so many degrees."""
    cv2.ellipse(image, at, axes, turn, 0, 360, colour, -1, cv2.LINE_AA)


def noise(
    rng: Rng, height: int, width: int, cell: float, octaves: int = 4, keep: float = 0.6
) -> Field:
    """Smooth noise (H, W) of zero mean and about unit sigma: octaves of random grids, the
    coarsest `cell` pixels wide.
    """
    octaves = min(octaves, max(1, 1 + int(np.log2(max(cell, 1.0)))))
    step, weight = cell, 1.0
    rows, columns = int(height / cell) + 3, int(width / cell) + 3
    total = rng.standard_normal((rows, columns), np.float32)
    for _ in range(octaves - 1):
        rows, columns, step, weight = 2 * rows, 2 * columns, step / 2, weight * keep
        total = cv2.resize(total, (columns, rows), interpolation=cv2.INTER_CUBIC)
        total += weight * rng.standard_normal((rows, columns), np.float32)
    size = (max(round(columns * step), width), max(round(rows * step), height))
    total = cv2.resize(total, size, interpolation=cv2.INTER_CUBIC)[:height, :width]
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def plain(height: int, width: int, colour: Colour) -> Texture:
    """One colour."""
    return np.full((height, width, 3), colour, np.float32)


def modulated(texture: Texture, field: Field, strength: float) -> Texture:
    """Brightness changed by a field: `strength` is the relative change at one sigma."""
    return texture * (1 + strength * field)[..., None]


def blended(texture: Texture, colour: Colour | Texture, alpha: Field) -> Texture:
    """A colour, or another texture, laid over with weight alpha (H, W), 0 to 1."""
    return texture + alpha[..., None] * (np.asarray(colour, np.float32) - texture)


def masonry(
    rng: Rng,
    height: int,
    width: int,
    block: tuple[float, float],
    palette: Sequence[Colour],
    joint: float = 1.5,
    joint_colour: Colour = (150, 155, 160),
    variation: float = 0.12,
) -> Texture:
    """Courses of blocks (length, height) in running bond; each block has a colour and a wear of
    its own.
    """
    length, course = block
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    y = y + 0.6 * noise(rng, height, width, 60, 2)
    x = x + 0.6 * noise(rng, height, width, 60, 2)
    row = np.floor(y / course).astype(int) + 1
    rows = int(row.max()) + 2
    shift = (np.arange(rows) % 2) * 0.5 + rng.uniform(-0.12, 0.12, rows)
    along = x / length + shift[row].astype(np.float32) + 1
    column = np.floor(along).astype(int)
    colours = np.asarray(palette, np.float32)[
        rng.integers(len(palette), size=(rows, int(column.max()) + 2))
    ]
    colours = colours * (1 + variation * rng.standard_normal((*colours.shape[:2], 1), np.float32))
    texture = colours[row, column]
    texture = modulated(texture, noise(rng, height, width, length / 3, 4, 0.8), 0.09)
    edge = np.minimum(y % course, (along - column) * length)
    mortar = np.clip(joint + 0.5 - edge, 0, 1)
    texture = blended(texture, joint_colour, 0.85 * mortar)
    # the upper edge of a block catches the light, the joint below is in shadow
    return texture * (1 - 0.18 * np.clip(1 - np.abs(course - (y % course)) / 1.5, 0, 1))[..., None]


def plaster(rng: Rng, height: int, width: int, colour: Colour, age: float = 1.0) -> Texture:
    """Rough plaster with clouds of discolouration, cracks, and patches mended in another tone."""
    texture = modulated(
        plain(height, width, colour), noise(rng, height, width, 90, 5, 0.7), 0.06 * age
    )
    texture = modulated(texture, noise(rng, height, width, 5, 3, 0.9), 0.05)
    for _ in range(rng.poisson(3 * age)):
        patch = noise(rng, height, width, rng.uniform(40, 120), 3)
        tone = rng.uniform(0.72, 1.15)
        texture = texture * (1 - (1 - tone) * np.clip((patch - 1.5) * 6, 0, 1))[..., None]
    return cracked(rng, texture, int(4 * age) + 1)


def cracked(rng: Rng, texture: Texture, count: int) -> Texture:
    """Cracks: random walks with a dark line."""
    height, width = texture.shape[:2]
    ink = np.zeros((height, width), np.uint8)
    for _ in range(count):
        steps = int(rng.integers(12, 45))
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.45, steps))
        start = rng.uniform((0, 0), (width, height))
        steps = np.column_stack((np.cos(heading), np.sin(heading)))
        line = start + np.cumsum(steps, 0) * rng.uniform(2, 6)
        cv2.polylines(ink, [np.rint(line * 8).astype(np.int32)], False, 255, 1, cv2.LINE_AA, 3)
    return blended(texture, (35, 40, 45), ink.astype(np.float32) / 255 * 0.7)


def patches(rng: Rng, height: int, width: int, cell: float, share: float) -> Field:
    """Islands with sharp, ragged shores: a mask (H, W), 0 to 1, that covers about `share`."""
    field = noise(rng, height, width, cell, 5, 0.62)
    level = float(np.quantile(field[::4, ::4], 1 - share))
    return np.clip((field - level) * cell * 0.25, 0, 1)


def lichen(rng: Rng, texture: Texture, cell: float) -> Texture:
    """Islands of lichen and soot, light and dark."""
    height, width = texture.shape[:2]
    for colour, share in (((60, 62, 64), 0.08), ((165, 195, 190), 0.07), ((70, 130, 150), 0.05)):
        mask = patches(rng, height, width, cell * rng.uniform(0.6, 1.4), share)
        texture = blended(texture, colour, 0.75 * mask)
    return texture


def wood(rng: Rng, height: int, width: int, colour: Colour, plank: float = 18) -> Texture:
    """Upright planks with grain and knots."""
    x = np.arange(width, dtype=np.float32)
    index = np.floor(x / plank).astype(int)
    tone = 1 + 0.16 * rng.standard_normal(index.max() + 1, np.float32)
    grain = cv2.resize(
        noise(rng, max(height // 12, 2), width, 5, 3, 0.9),
        (width, height),
        interpolation=cv2.INTER_CUBIC,
    )
    boards: Texture = plain(height, width, colour) * tone[index][None, :, None]
    texture = modulated(boards, np.asarray(grain, np.float32), 0.13)
    texture = modulated(texture, noise(rng, height, width, 50, 4), 0.08)
    for u, v in rng.uniform((0, 0), (width, height), (height * width // 4000, 2)):
        spot(texture, (int(u), int(v)), (2, 4), 0, [0.5 * c for c in colour])
    gap = np.clip(1.5 - x % plank, 0, 1)[None, :].repeat(height, 0)
    return blended(texture, (20, 22, 25), 0.8 * gap)


def roof_tiles(
    rng: Rng, height: int, width: int, palette: Sequence[Colour], tile: float = 20
) -> Texture:
    """Overlapping rows of tiles, moss included."""
    texture = masonry(rng, height, width, (tile, tile * 0.8), palette, 1.2, (30, 32, 38), 0.18)
    row = np.arange(height, dtype=np.float32) % (tile * 0.8) / (tile * 0.8)
    texture = texture * (0.78 + 0.3 * row)[:, None, None]
    moss = np.clip(noise(rng, height, width, 70, 5, 0.75) - 1.0, 0, 1)
    return blended(texture, (55, 95, 85), 0.7 * moss)


def paving(rng: Rng, size: int, slab: float) -> Texture:
    """A square of worn slabs with patches of cobble, stains, leaves and litter."""
    whole, small = (slab * 1.4, slab), (slab * 0.34, slab * 0.3)
    slabs = masonry(rng, size, size, whole, _SLABS, 1.4, (112, 118, 122), 0.06)
    cobbles = masonry(rng, size, size, small, _COBBLES, 1.5, (82, 87, 90), 0.1)
    where = np.clip(noise(rng, size, size, size / 5, 3, 0.5) * 12 - 4, 0, 1)
    texture = blended(slabs, cobbles, where)
    texture = modulated(texture, noise(rng, size, size, size / 6, 7, 0.7), 0.1)
    return _littered(rng, texture)


def _littered(rng: Rng, texture: Texture) -> Texture:
    size = texture.shape[0]
    stains = np.zeros((size, size), np.uint8)
    for _ in range(size // 9):
        centre, axes = rng.integers(0, size, 2).tolist(), rng.integers(3, 26, 2).tolist()
        turn = float(rng.uniform(0, 180))
        spot(stains, centre, axes, turn, [int(rng.integers(70, 200))])
    stains = cv2.GaussianBlur(stains, (0, 0), 2.0).astype(np.float32) / 255
    texture = texture * (1 - 0.5 * stains)[..., None]
    for _ in range(size):
        colour = one_of(rng, _LITTER)
        centre, axes = rng.integers(0, size, 2).tolist(), rng.integers(2, 6, 2).tolist()
        spot(texture, centre, axes, float(rng.uniform(0, 180)), colour)
    return cracked(rng, texture, size // 40)


def sky(rng: Rng, height: int, width: int) -> Texture:
    """A panorama, full circle by 90 degrees above the horizon (last row): clouds on a gradient."""
    up = np.linspace(1, 0, height, dtype=np.float32)[:, None]
    tones = ((205, 232), (150, 216), (105, 200))
    shades = [np.broadcast_to(a * up + b * (1 - up), (height, width)) for a, b in tones]
    clear = np.stack(shades, -1)
    tile = noise(rng, height, 2 * width, width / 14, 6, 0.6)
    fade = np.linspace(0, 1, width, dtype=np.float32)[None, :]
    # the first column continues the last
    seamless = tile[:, width:] * (1 - fade) + tile[:, :width] * fade
    cloud = np.clip(0.9 * seamless - 0.1, 0, 1) * np.clip(1.6 * up + 0.25, 0, 1)
    return blended(clear.astype(np.float32), (246, 243, 240), 0.85 * cloud)
