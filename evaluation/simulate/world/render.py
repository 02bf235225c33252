"""A renderer of textured quads: exact depth, perspective-correct textures, mip levels, a sky. numpy
and OpenCV only.

Along an image, u/z, v/z and 1/z of a plane are affine in the pixel. So a quad is five affine
functions: its four edges and its inverse depth. The nearest quad of every sample is found first,
    colours are looked up once afterwards, from one atlas
that holds all textures at all levels.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.simulate.world.materials.textures import Texture

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Depth = npt.NDArray[np.float32]

LEVELS = 5
_ALIGN = 2 ** (LEVELS - 1)  # a texture starts at a whole texel of every level
_NEAR_M = 0.05
_BAND = 32  # rows shaded at once: their arrays stay in the processor's cache


@dataclass(frozen=True)
class Quad:
    """A textured parallelogram, seen from one side.

    Attributes:
        corner: (3,) its top left corner, world, metres.
        right, down: (3,) its edges as seen from outside; right x down points into the wall.
        texture: (H, W, 3) uint8 BGR.
        taper: share of the width that is gone at the top: 0 a parallelogram, 1 a triangle.
    """

    corner: Floats
    right: Floats
    down: Floats
    texture: Image
    taper: float = 0.0

    @property
    def outward(self) -> Floats:
        """Unit normal towards who sees it."""
        normal = np.cross(self.down, self.right)
        return normal / np.linalg.norm(normal)


class Rendering(NamedTuple):
    """An image (H, W, 3) uint8 BGR and the exact depth (H, W) float32 at pixel centres, metres,
    nan in the sky.
    """

    image: Image
    depth: Depth


class _Placed(NamedTuple):
    """Textures on one canvas: where each starts and how large it is, texels of level 0; where
    each level starts.
    """

    canvas: Image
    starts: Floats
    sizes: Floats
    level_starts: Floats


class Renderer:
    """Renders a fixed scene. Safe to use from several threads."""

    def __init__(self, quads: Sequence[Quad], sky: Texture) -> None:
        self._quads = tuple(quads)
        self._enter()
        self._atlas = _place([q.texture for q in quads])
        lengths = np.array([(np.linalg.norm(q.right), np.linalg.norm(q.down)) for q in quads])
        self._texels_per_m = np.sqrt((self._atlas.sizes / lengths).prod(1))
        wrapped = np.concatenate((sky, sky[:, :1]), axis=1)
        self._sky = np.clip(wrapped, 0, 255).astype(np.uint8)

    def _enter(self) -> None:
        """Notes where the quads are."""
        quads = self._quads
        self._corners = np.array([q.corner for q in quads])
        self._outlines = np.array(
            [q.corner + np.array((0 * q.down, q.right, q.right + q.down, q.down)) for q in quads]
        )
        self._outward = np.array([q.outward for q in quads])
        self._M = np.array([np.column_stack((q.right, q.down, q.corner)) for q in quads])

    def with_quads(self, quads: Sequence[Quad]) -> "Renderer":
        """The same scene with more in it."""
        return Renderer((*self._quads, *quads), self._sky[:, :-1].astype(np.float32))

    def with_last_at(self, quads: Sequence[Quad]) -> "Renderer":
        """The same scene with its last quads at other places, their textures as they are: fit for
        every frame.
        """
        moved = copy.copy(self)
        first = len(self._quads) - len(quads)
        moved._quads = (*self._quads[:first], *quads)
        moved._enter()
        return moved

    def render(self, T_world_camera: Floats, K: Floats, size: tuple[int, int]) -> Rendering:
        """An image without sensor noise, and the exact depth, of a pinhole camera.

        Args:
            T_world_camera: (4, 4) pose, OpenCV axes.
            K: (3, 3) intrinsics, px.
            size: width, height.
        """
        return Rendering(self.image(T_world_camera, K, size), self.depth(T_world_camera, K, size))

    def depth(self, T_world_camera: Floats, K: Floats, size: tuple[int, int]) -> Depth:
        """Exact depth along the optical axis at pixel centres, nan in the sky."""
        _, inverse, _ = self._visible(T_world_camera, K, size)
        with np.errstate(divide="ignore"):
            return np.where(inverse > 0, 1 / inverse, np.nan).astype(np.float32)

    def image(
        self, T_world_camera: Floats, K: Floats, size: tuple[int, int], samples: int = 2
    ) -> Image:
        """The image alone; each pixel is the mean of `samples` x `samples` samples."""
        fine = np.diag((samples, samples, 1.0)) @ _offset((samples - 1) / (2 * samples)) @ K
        fine_size = (size[0] * samples, size[1] * samples)
        ids, inverse, maps = self._visible(T_world_camera, fine, fine_size)
        colours = self._shade(ids, inverse, maps, T_world_camera, fine)
        self._paint_sky(colours, ids < 0, T_world_camera, fine, samples)
        if samples == 1:
            return colours
        return np.asarray(cv2.resize(colours, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _visible(
        self, T_world_camera: Floats, K: Floats, size: tuple[int, int]
    ) -> tuple[npt.NDArray[np.intp], Depth, Floats]:
        """Which quad each pixel shows (-1: sky), its inverse depth, and per quad pixel -> (u/z,
        v/z, 1/z).
        """
        R, centre = T_world_camera[:3, :3], T_world_camera[:3, 3]
        facing = ((centre - self._corners) * self._outward).sum(1) > 1e-6
        moved = self._M.copy()
        moved[:, :, 2] -= centre
        maps = np.zeros_like(moved)
        maps[facing] = np.linalg.inv(R.T @ moved[facing]) @ np.linalg.inv(K)
        width, height = size
        ids = np.full((height, width), -1, np.intp)
        inverse = np.zeros((height, width), np.float32)
        shown = np.nonzero(facing)[0]
        boxes = _boxes((self._outlines[shown] - centre) @ R, K, size)
        for q, (left, top, right, bottom) in zip(shown.tolist(), boxes.tolist(), strict=True):
            if left < right and top < bottom:
                box = slice(top, bottom), slice(left, right)
                _draw(q, maps[q], self._quads[q].taper, box, ids, inverse)
        return ids, inverse, maps

    def _shade(
        self,
        ids: npt.NDArray[np.intp],
        inverse: Depth,
        maps: Floats,
        T_world_camera: Floats,
        K: Floats,
    ) -> Image:
        """Looks every sample up in the atlas, at the level that fits its footprint."""
        atlas = self._atlas
        # texel / z is affine in the pixel: size * u/z + start * 1/z
        texels = maps[:, :2] * atlas.sizes[:, :, None] + maps[:, 2:] * atlas.starts[:, :, None]
        table = texels.reshape(-1, 6).T.astype(np.float32)
        footprints = self._footprints(T_world_camera, K)
        origin = atlas.level_starts.T.astype(np.float32) - 0.5
        scales = (0.5 ** np.arange(LEVELS)).astype(np.float32)
        x = np.arange(ids.shape[1], dtype=np.float32)
        colours = np.empty((*ids.shape, 3), np.uint8)
        for top in range(0, len(ids), _BAND):
            band = slice(top, top + _BAND)
            q = ids[band]
            y = np.arange(top, top + len(q), dtype=np.float32)[:, None]
            z = 1 / np.maximum(inverse[band], 1e-6)
            level = _levels(np.take(footprints, q, mode="clip") * z * np.sqrt(z))
            scale = np.take(scales, level) * z
            a, b, c, d, e, f = (np.take(row, q, mode="clip") for row in table)
            map_x = (a * x + b * y + c) * scale + np.take(origin[0], level)
            map_y = (d * x + e * y + f) * scale + np.take(origin[1], level)
            cv2.remap(
                atlas.canvas, map_x, map_y, cv2.INTER_LINEAR, colours[band], cv2.BORDER_REPLICATE
            )
        return colours

    def _footprints(self, T_world_camera: Floats, K: Floats) -> Depth:
        """Per quad: texels under a sample, over z^1.5; the geometric mean of both directions on a
        slanted wall.

        Across it is t z / f; along it, that over the cosine of incidence, which is distance / z
        near the axis.
        """
        distance = np.abs(((T_world_camera[:3, 3] - self._corners) * self._outward).sum(1))
        return (self._texels_per_m / K[0, 0] / np.sqrt(np.maximum(distance, 1e-3))).astype(
            np.float32
        )

    def _paint_sky(
        self,
        colours: Image,
        where: npt.NDArray[np.bool_],
        T_world_camera: Floats,
        K: Floats,
        samples: int,
    ) -> None:
        """The sky is smooth: it is looked up once per pixel, not per sample."""
        rows = np.nonzero(where.any(1))[0]
        if not len(rows):
            return
        height, width = (rows[-1] // samples + 1) * samples, where.shape[1]
        x, y = np.arange(0, width, samples), np.arange(0, height, samples)
        ray = [_affine(row, x, y) for row in T_world_camera[:3, :3] @ np.linalg.inv(K)]
        turn = np.arctan2(ray[1], ray[0]) / np.float32(2 * np.pi) % 1
        up = ray[2] / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
        map_x = turn * (self._sky.shape[1] - 1)
        map_y = (1 - np.clip(up, 0, 1)) * (self._sky.shape[0] - 1)
        sky = cv2.remap(self._sky, map_x, map_y, cv2.INTER_LINEAR)
        sky = sky.repeat(samples, 0).repeat(samples, 1)
        np.copyto(colours[:height], sky, where=where[:height, :, None])


def _levels(footprint: npt.NDArray[np.floating]) -> npt.NDArray[np.intp]:
    """Mip level for so many texels under a sample."""
    return np.clip(np.log2(footprint) + 0.4, 0, LEVELS - 1).astype(np.intp)


def _offset(shift: float) -> Floats:
    """Pixel centres are integers on both grids: moves the coarse grid's origin to that of the
    fine one.
    """
    return np.array([[1, 0, shift], [0, 1, shift], [0, 0, 1.0]])


def _boxes(outlines: Floats, K: Floats, size: tuple[int, int]) -> npt.NDArray[np.int64]:
    """Per outline (N, 4, 3) in the camera frame: left, top, right, bottom of what it may cover;
    empty if nothing.
    """
    boxes = np.zeros((len(outlines), 4), np.int64)
    front = outlines[:, :, 2] > _NEAR_M
    whole = front.all(1)
    if whole.any():
        boxes[whole] = _extent(outlines[whole], K, size)
    for k in np.nonzero(front.any(1) & ~whole)[0]:
        boxes[k] = _extent(_in_front(outlines[k])[None], K, size)[0]
    return boxes


def _extent(polygons: Floats, K: Floats, size: tuple[int, int]) -> npt.NDArray[np.int64]:
    pixels = polygons @ K.T
    pixels = pixels[..., :2] / pixels[..., 2:]
    low = np.clip(np.floor(pixels.min(1)), 0, size)
    high = np.clip(np.ceil(pixels.max(1)) + 1, 0, size)
    return np.hstack((low, high)).astype(np.int64)


def _in_front(polygon: Floats) -> Floats:
    """The polygon's part before the near plane."""
    kept = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[2] > _NEAR_M:
            kept.append(a)
        if (a[2] > _NEAR_M) != (b[2] > _NEAR_M):
            kept.append(a + (b - a) * (_NEAR_M - a[2]) / (b[2] - a[2]))
    return np.array(kept)


def _draw(
    q: int,
    mapping: Floats,
    taper: float,
    box: tuple[slice, slice],
    ids: npt.NDArray[np.intp],
    inverse: Depth,
) -> None:
    """Enters a quad where it is in front of what is there."""
    y = np.arange(box[0].start, box[0].stop)
    x = np.arange(box[1].start, box[1].stop)
    u, v, w = mapping
    lost = 0.5 * taper * (w - v)
    depth = inverse[box]
    mine = _affine(w, x, y)
    hit = mine > depth
    for edge in (u - lost, w - u - lost, v, w - v):
        hit &= _affine(edge, x, y) >= 0
    np.copyto(depth, mine, where=hit)
    np.copyto(ids[box], q, where=hit)


def _affine(abc: Floats, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp]) -> Depth:
    return np.add.outer((abc[1] * y + abc[2]).astype(np.float32), (abc[0] * x).astype(np.float32))


def _place(textures: Sequence[Image]) -> _Placed:
    """Puts every texture on one canvas, once however many quads show it."""
    distinct = {id(texture): texture for texture in textures}
    order = {key: k for k, key in enumerate(distinct)}
    which = np.array([order[id(texture)] for texture in textures])
    placed = _packed(list(distinct.values()))
    return placed._replace(starts=placed.starts[which], sizes=placed.sizes[which])


def _packed(textures: Sequence[Image]) -> _Placed:
    """Packs textures on shelves, each with a border of its own edge colours, and adds the
    coarser levels beside.
    """
    sizes = np.array([(t.shape[1], t.shape[0]) for t in textures])
    cells = (sizes + 2 * _ALIGN + _ALIGN - 1) // _ALIGN * _ALIGN
    width = max(int(np.sqrt(cells.prod(1).sum()) / _ALIGN + 1) * _ALIGN, int(cells[:, 0].max()))
    starts = np.zeros_like(sizes)
    x = y = shelf = 0
    for k in np.argsort(-cells[:, 1], kind="stable"):
        if x + cells[k, 0] > width:
            x, y, shelf = 0, y + shelf, 0
        starts[k] = x + _ALIGN, y + _ALIGN
        x, shelf = x + cells[k, 0], max(shelf, cells[k, 1])
    height = int(y + shelf)
    base = np.zeros((height, width, 3), np.uint8)
    for texture, (left, top), cell in zip(textures, starts, cells, strict=True):
        h, w = texture.shape[:2]
        bordered = cv2.copyMakeBorder(
            texture,
            _ALIGN,
            cell[1] - h - _ALIGN,
            _ALIGN,
            cell[0] - w - _ALIGN,
            cv2.BORDER_REPLICATE,
        )
        base[top - _ALIGN : top - _ALIGN + cell[1], left - _ALIGN : left - _ALIGN + cell[0]] = (
            bordered
        )
    canvas, level_starts = _with_levels(base)
    return _Placed(canvas, starts.astype(float), sizes.astype(float), level_starts)


def _with_levels(base: Image) -> tuple[Image, Floats]:
    height, width = base.shape[:2]
    canvas = np.zeros((height, width + width // 2 + 1, 3), np.uint8)
    canvas[:, :width] = base
    starts = np.zeros((LEVELS, 2))
    top, level = 0, base
    for k in range(1, LEVELS):
        level = cv2.resize(
            level, (level.shape[1] // 2, level.shape[0] // 2), interpolation=cv2.INTER_AREA
        )
        canvas[top : top + level.shape[0], width : width + level.shape[1]] = level
        starts[k] = width, top
        top += level.shape[0]
    return canvas, starts
