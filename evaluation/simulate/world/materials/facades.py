"""Facades of the synthetic world: materials with windows, doors, posters, ivy and stains.

Windows of one facade share their make, as real ones do, but not what stands behind the glass.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fleetpose.evaluation.simulate.world.materials import colours, textures
from fleetpose.evaluation.simulate.world.materials.textures import Colour, Rng, Texture


@dataclass(frozen=True)
class Style:
    """How a facade is dressed; lengths in metres, rates per square metre."""

    material: str
    floor_m: float = 1.5
    window_m: tuple[float, float] = (0.55, 0.85)
    windows: bool = True
    posters: float = 0.5
    ivy: float = 0.5
    graffiti: int = 1
    door: bool = True


def facade(rng: Rng, width_m: float, height_m: float, pixels_per_m: float, style: Style) -> Texture:
    """One wall, seen from outside: (height, width, 3)."""
    width, height = round(width_m * pixels_per_m), round(height_m * pixels_per_m)
    wall = wall_of(rng, height, width, pixels_per_m, style.material)
    wall = weathered(rng, wall, pixels_per_m)
    if style.windows:
        wall = _windows(rng, wall, pixels_per_m, style)
    if style.door:
        _door(rng, wall, pixels_per_m)
    for _ in range(rng.poisson(style.posters * width_m * min(height_m, 2.2))):
        _poster(rng, wall, pixels_per_m)
    for _ in range(rng.poisson(style.graffiti)):
        wall = _graffiti(rng, wall, pixels_per_m)
    if rng.uniform() < style.ivy:
        wall = _ivy(rng, wall, pixels_per_m)
    return np.clip(wall, 0, 255)


def wall_of(rng: Rng, height: int, width: int, pixels_per_m: float, material: str) -> Texture:
    """The bare wall of a material: brick, stone, grey, render, wood."""
    p = pixels_per_m
    if material == "brick":
        bricks = textures.masonry(
            rng, height, width, (0.25 * p, 0.085 * p), colours.BRICK, 0.012 * p, variation=0.2
        )
        whitewash = textures.patches(rng, height, width, 0.4 * p, float(rng.uniform(0.1, 0.25)))
        return textures.lichen(
            rng, textures.blended(bricks, (150, 165, 180), 0.6 * whitewash), 0.3 * p
        )
    if material == "stone":
        block, mortar = (0.5 * p, 0.27 * p), (110, 118, 124)
        blocks = textures.masonry(rng, height, width, block, colours.STONE, 0.014 * p, mortar, 0.2)
        return textures.lichen(rng, blocks, 0.3 * p)
    if material == "grey":
        block, mortar = (0.6 * p, 0.4 * p), (80, 84, 86)
        blocks = textures.masonry(rng, height, width, block, colours.GREY, 0.012 * p, mortar, 0.15)
        return textures.lichen(rng, blocks, 0.35 * p)
    colour = textures.one_of(rng, colours.RENDERS)
    if material == "wood":
        return textures.wood(rng, height, width, colour, 0.14 * p)
    # plaster that has come off in places shows the bricks below
    bricks = textures.masonry(rng, height, width, (0.25 * p, 0.085 * p), colours.BRICK, 0.012 * p)
    bare = textures.patches(rng, height, width, 0.5 * p, float(rng.uniform(0.12, 0.3)))
    return textures.blended(textures.plaster(rng, height, width, colour, 1.2), bricks, bare)


def weathered(rng: Rng, wall: Texture, pixels_per_m: float) -> Texture:
    """Clouds of dirt, darker feet, and streaks that run down."""
    height, width = wall.shape[:2]
    wall = textures.modulated(
        wall, textures.noise(rng, height, width, 0.9 * pixels_per_m, 6, 0.7), 0.1
    )
    streaks = textures.noise(rng, max(height // 14, 2), width, 9, 3, 0.8)
    streaks = cv2.resize(streaks, (width, height), interpolation=cv2.INTER_CUBIC)
    streaks = np.clip(streaks - 0.7, 0, 2)
    foot = np.exp(-np.arange(height, dtype=np.float32)[::-1] / (0.3 * pixels_per_m))[:, None]
    foot = foot * np.clip(
        0.7 + 0.4 * textures.noise(rng, height, width, 0.4 * pixels_per_m, 4), 0, 1.2
    )
    return wall * np.clip(1 - 0.13 * streaks - 0.4 * foot, 0.25, 1)[..., None]


def _windows(rng: Rng, wall: Texture, p: float, style: Style) -> Texture:
    height, width = wall.shape[:2]
    w, h = round(style.window_m[0] * p), round(style.window_m[1] * p)
    floors = int((height - 0.2 * p) // (style.floor_m * p))
    columns = int((width - 0.15 * p) // (w * 1.55))
    if columns < 1:
        return wall
    frame = _print(rng)
    bars = int(rng.integers(1, 3)), int(rng.integers(1, 4))
    for floor in range(floors):
        top = round(height - (floor + 1) * style.floor_m * p + 0.18 * p)
        for column in range(columns):
            left = round((column + 0.5) * width / columns - w / 2)
            if style.door and floor == 0 and column == columns // 2:
                continue
            _window(rng, wall[max(top, 0) : top + h, left : left + w], frame, bars)
            _sill(rng, wall, left, top + h, w, p)
    return wall


def _window(rng: Rng, hole: Texture, frame: Colour, bars: tuple[int, int]) -> None:
    """Draws glass with what is behind it, then the frame, into a part of the wall."""
    h, w = hole.shape[:2]
    if h < 12 or w < 8:
        return
    room = textures.plain(h, w, (45, 38, 34))
    room = textures.modulated(room, textures.noise(rng, h, w, h / 2, 5, 0.8), 0.35)
    room += np.linspace(float(rng.uniform(20, 70)), 0, h, dtype=np.float32)[:, None, None]
    kind = rng.integers(5)
    colour = _print(rng)
    if kind == 0:  # a blind, let down by some part
        drop = int(h * rng.uniform(0.2, 0.9))
        slats = (0.85 + 0.15 * np.sin(np.arange(drop) * 1.3))[:, None, None]
        room[:drop] = np.asarray(colour) * slats
    elif kind == 1:  # curtains at both sides
        part = int(w * rng.uniform(0.12, 0.42))
        folds = (0.8 + 0.2 * np.sin(np.arange(part) * rng.uniform(0.6, 1.2)))[None, :, None]
        room[:, :part], room[:, w - part :] = np.asarray(colour) * folds, np.asarray(colour) * folds
    elif kind == 2:  # plants on the sill
        for _ in range(int(rng.integers(6, 22))):
            at = int(rng.integers(w)), int(h - rng.exponential(0.15) * h)
            radius = int(rng.integers(2, 5))
            textures.dot(room, at, radius, rng.uniform((20, 70, 20), (90, 170, 90)).tolist())
    elif kind == 3:  # a lamp is on
        glow = np.exp(-((np.mgrid[0:h, 0:w][0] / h - 0.4) ** 2) * 6)[..., None]
        room += 90 * glow * np.array((0.5, 0.85, 1.0))
    hole[:] = np.clip(room, 0, 255)
    thick = max(2, w // 18)
    for i in range(bars[0] + 1):
        x = round(i * (w - thick) / bars[0])
        cv2.rectangle(hole, (x, 0), (x + thick - 1, h), frame, -1)
    for i in range(bars[1] + 1):
        y = round(i * (h - thick) / bars[1])
        cv2.rectangle(hole, (0, y), (w, y + thick - 1), frame, -1)
    hole[: 2 * thick] *= 0.55  # the lintel's shadow


def _sill(rng: Rng, wall: Texture, left: int, top: int, w: int, p: float) -> None:
    deep = max(2, round(0.06 * p))
    band = wall[top : top + deep, max(left - deep, 0) : left + w + deep]
    band[:] = np.asarray((185, 190, 195)) * rng.uniform(0.8, 1.1)
    below = wall[top + deep : top + deep + int(rng.uniform(0.1, 0.5) * p), max(left, 0) : left + w]
    if below.size:  # rain drips from the sill
        streak = np.clip(rng.normal(0.1, 0.14, below.shape[1]), 0, 0.5)[None, :, None]
        below *= 1 - streak * np.linspace(1, 0, below.shape[0])[:, None, None]
    if rng.uniform() < 0.3:
        for _ in range(14):
            at = int(rng.integers(left, left + w)), int(top - rng.uniform(0, 0.14) * p)
            textures.dot(wall, at, int(rng.integers(2, 5)), textures.one_of(rng, colours.PAINTS))


def _door(rng: Rng, wall: Texture, p: float) -> None:
    height, width = wall.shape[:2]
    w, h = min(round(rng.uniform(0.7, 0.9) * p), int(width * 0.7)), min(round(1.45 * p), height - 4)
    left = (width - w) // 2
    colour = textures.one_of(rng, colours.PAINTS)
    panel = textures.wood(rng, h, w, colour, w / 4.5)
    rim = round(0.06 * p)
    wall[height - h - rim :, max(left - rim, 0) : left + w + rim] *= 0.65
    wall[height - h :, left : left + w] = panel
    inset = max(3, w // 8)
    for top in (0.08, 0.55):
        a = (left + inset, height - h + int(top * h))
        b = (left + w - inset, a[1] + int(0.36 * h))
        ink, thick = [0.45 * c for c in colour], max(1, inset // 4)
        cv2.rectangle(wall, a, b, ink, thick, cv2.LINE_AA)
    handle = (left + w - inset // 2, height - h // 2)
    textures.dot(wall, handle, max(2, inset // 3), (60, 190, 220))
    _text(rng, wall, (left, height - h - round(0.1 * p)), 0.18 * p, (230, 235, 240))


def _poster(rng: Rng, wall: Texture, p: float) -> None:
    height, width = wall.shape[:2]
    w = round(rng.uniform(0.22, 0.5) * p)
    h = round(w * rng.uniform(1.1, 1.6))
    reach = min(height - h - 2, int(1.9 * p))
    if width - w < 4 or reach < 2:
        return
    left, top = int(rng.integers(0, width - w)), height - h - int(rng.integers(0, reach)) - 1
    wall[top : top + h, left : left + w] = poster(rng, h, w)


def poster(rng: Rng, height: int, width: int) -> Texture:
    """Paper with shapes, a word and lines of print; torn and faded."""
    paper = textures.plain(height, width, _print(rng))
    for _ in range(int(rng.integers(3, 8))):
        colour = _print(rng)
        points = rng.uniform((0, 0), (width, height), (int(rng.integers(3, 6)), 2)).astype(np.int32)
        if rng.uniform() < 0.5:
            cv2.fillPoly(paper, [points], colour, cv2.LINE_AA)
        else:
            radius = int(rng.uniform(0.08, 0.35) * width) + 1
            thick = int(rng.choice([-1, 2]))
            cv2.circle(paper, points[0].tolist(), radius, colour, thick, cv2.LINE_AA)
    at = (int(0.06 * width), int(rng.uniform(0.25, 0.9) * height))
    _text(rng, paper, at, 0.3 * width, _print(rng))
    for row in range(int(rng.integers(2, 6))):
        y = int((0.6 + 0.06 * row) * height)
        end = (int(width * rng.uniform(0.5, 0.9)), y)
        cv2.line(paper, (width // 8, y), end, (40, 40, 40), 1, cv2.LINE_AA)
    cv2.rectangle(paper, (0, 0), (width - 1, height - 1), (225, 225, 225), 1)
    return textures.modulated(paper, textures.noise(rng, height, width, width / 2, 5, 0.75), 0.08)


def _text(
    rng: Rng, image: Texture, at: tuple[int, int], height_px: float, colour: Colour | list[float]
) -> None:
    word = textures.one_of(rng, colours.WORDS)
    scale = height_px / 30
    thick = max(1, round(scale * 1.6))
    ink = np.zeros(image.shape[:2], np.uint8)
    cv2.putText(ink, word, at, cv2.FONT_HERSHEY_DUPLEX, scale, 255, thick, cv2.LINE_AA)
    rows, columns = np.nonzero(ink)
    alpha = ink[rows, columns, None].astype(np.float32) / 255
    image[rows, columns] += alpha * (np.asarray(colour, np.float32) - image[rows, columns])


def _graffiti(rng: Rng, wall: Texture, p: float) -> Texture:
    height, width = wall.shape[:2]
    ink = np.zeros((height, width), np.uint8)
    size = rng.uniform(0.25, 0.6) * p
    at = np.array((rng.uniform(0.1, 0.7) * width, height - rng.uniform(0.3, 1.2) * p))
    for letter in range(int(rng.integers(2, 6))):
        t = np.linspace(0, 1, 30)[:, None]
        bends = rng.uniform(-0.5, 0.5, (4, 2)) * size
        weights = np.hstack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
        line = at + (letter * 0.6 * size, 0) + weights @ bends * 1.6
        eighths, thick = [np.rint(line * 8).astype(np.int32)], max(2, round(0.035 * p))
        cv2.polylines(ink, eighths, False, 255, thick, cv2.LINE_AA, 3)
    spray = cv2.GaussianBlur(ink, (0, 0), 0.8).astype(np.float32) / 255
    return textures.blended(wall, textures.one_of(rng, colours.PAINTS), 0.9 * spray)


def _ivy(rng: Rng, wall: Texture, p: float) -> Texture:
    """Leaves, many at the foot and around one or two stems, fewer higher up."""
    height, width = wall.shape[:2]
    reach = rng.uniform(0.35, 0.95) * height
    stem = rng.uniform(0, width)
    count = int(reach * rng.uniform(0.6, 1.2))
    up = rng.beta(1, 1.8, count) * reach
    x = stem + np.sin(up / p * 1.7) * 0.2 * p + rng.normal(0, 0.16 * p + 0.12 * (reach - up))
    leaves = rng.uniform((25, 65, 30), (80, 150, 105), (count, 3))
    leaves = leaves * rng.uniform(0.5, 1.15, (count, 1))
    axes, turns = rng.integers(2, 5, (count, 2)).tolist(), rng.uniform(0, 180, count).tolist()
    places = np.column_stack((x, height - up)).astype(int).tolist()
    for place, leaf, axis, turn in zip(places, leaves.tolist(), axes, turns, strict=True):
        textures.spot(wall, place, axis, turn, leaf)
    return wall


def _print(rng: Rng) -> Colour:
    tone = rng.uniform(0.8, 1.15)
    b, g, r = textures.one_of(rng, colours.PRINTS)
    return b * tone, g * tone, r * tone


def hoarding(rng: Rng, width_m: float, height_m: float, pixels_per_m: float) -> Texture:
    """A surface pasted over with posters, layer on layer (advertising columns, fences)."""
    height, width = round(height_m * pixels_per_m), round(width_m * pixels_per_m)
    board = textures.wood(rng, height, width, (120, 140, 150), 0.2 * pixels_per_m)
    for _ in range(int(9 * width_m * height_m) + 2):
        w = min(round(rng.uniform(0.25, 0.55) * pixels_per_m), width - 1)
        h = min(round(w * rng.uniform(1.1, 1.5)), height - 1)
        left, top = int(rng.integers(0, width - w + 1)), int(rng.integers(0, height - h + 1))
        board[top : top + h, left : left + w] = poster(rng, h, w)
    return weathered(rng, board, pixels_per_m)


def awning(rng: Rng, width_m: float, depth_m: float, pixels_per_m: float) -> Texture:
    """Striped cloth, faded and patched."""
    height, width = round(depth_m * pixels_per_m), round(width_m * pixels_per_m)
    a, b = np.asarray(textures.one_of(rng, colours.PAINTS)) * 1.2, np.asarray((215, 225, 230))
    stripe = (np.arange(width) // max(0.16 * pixels_per_m, 3)).astype(int) % 2
    cloth = np.where(stripe[None, :, None] == 0, a, b).astype(np.float32).repeat(height, 0)
    cloth = textures.modulated(
        cloth, textures.noise(rng, height, width, 0.4 * pixels_per_m, 6, 0.75), 0.13
    )
    return textures.cracked(rng, cloth, 3)


def crate(rng: Rng, width_m: float, height_m: float, pixels_per_m: float) -> Texture:
    """Boards with a stencilled word."""
    height, width = round(height_m * pixels_per_m), round(width_m * pixels_per_m)
    boards = (
        textures.wood(rng, width, height, (95, 135, 170), 0.11 * pixels_per_m)
        .transpose(1, 0, 2)
        .copy()
    )
    _text(rng, boards, (int(0.1 * width), int(0.65 * height)), 0.2 * width, (40, 45, 50))
    return weathered(rng, boards, pixels_per_m)
