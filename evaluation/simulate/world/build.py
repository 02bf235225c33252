"""Walls, boxes, roofs: solids put together from textured and lit quads.

World frame: z up, the ground at z = 0; metres. Outlines on the ground run counter-clockwise as
    seen from above.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fleetpose.evaluation.simulate.world.materials.textures import Rng, Texture
from fleetpose.evaluation.simulate.world.render import Floats, Quad

SUN = np.array((0.55, -0.42, 0.72))
"""Unit vector towards the sun."""
Paint = Callable[[Rng, float, float], Texture]
"""Makes the texture of a surface from its width and height in metres."""


@dataclass
class Builder:
    """Collects lit quads and the outlines that throw shadows."""

    rng: Rng
    quads: list[Quad] = field(default_factory=list)
    shadows: list[tuple[Floats, float]] = field(default_factory=list)

    def wall(
        self,
        a: Floats,
        b: Floats,
        z: tuple[float, float],
        paint: Paint,
        lean: float = 0.0,
        taper: float = 0.0,
    ) -> None:
        """An upright wall over the ground line a to b, which is left to right as seen from outside.

        With `lean` the top edge stands back (towards the inside) by so many metres: a roof.
        """
        right = np.append(b - a, 0.0)
        inside = np.array((-right[1], right[0], 0.0)) / np.linalg.norm(right)
        top_left = np.append(a, z[1]) + lean * inside
        down = np.array((0.0, 0.0, z[0] - z[1])) - lean * inside
        self._add(top_left, right, down, paint, taper)

    def slab(self, centre: Floats, along: Floats, across: Floats, z: float, paint: Paint) -> None:
        """A level surface seen from above; `along` and `across` are its half sizes, `across`
        left of `along`.
        """
        corner = np.append(centre - along + across, z)
        self._add(corner, np.append(2 * along, 0.0), np.append(-2 * across, 0.0), paint, 0.0)

    def ceiling(
        self, centre: Floats, along: Floats, across: Floats, z: float, paint: Paint
    ) -> None:
        """A level surface seen from below; arguments as of `slab`."""
        corner = np.append(centre - along - across, z)
        self._add(corner, np.append(2 * along, 0.0), np.append(2 * across, 0.0), paint, 0.0)

    def box(
        self, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], paint: Paint
    ) -> None:
        """A box along the axes, painted on all sides that can be seen from outside."""
        outline = np.array(((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])))
        self.prism(outline, z, paint, top=paint)
        if z[0] > 0:
            along, across = np.array(((x[1] - x[0]) / 2, 0.0)), np.array((0.0, (y[1] - y[0]) / 2))
            self.ceiling(outline.mean(0), along, across, z[0], paint)

    def _add(self, corner: Floats, right: Floats, down: Floats, paint: Paint, taper: float) -> None:
        texture = paint(self.rng, float(np.linalg.norm(right)), float(np.linalg.norm(down)))
        normal = np.cross(down, right) / np.linalg.norm(np.cross(down, right))
        light = 0.74 + 0.5 * max(float(normal @ SUN), 0.0)
        tint = np.array((1.06, 1.0, 0.94)) if normal @ SUN <= 0 else np.array((0.96, 1.0, 1.03))
        lit = np.clip(texture * light * tint, 0, 255).astype(np.uint8)
        self.quads.append(Quad(corner, right, down, lit, taper))

    def prism(
        self, outline: Floats, z: tuple[float, float], paint: Paint, top: Paint | None = None
    ) -> None:
        """Walls over a convex outline (N, 2), counter-clockwise from above; four-sided ones may
        have a top.
        """
        for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            self.wall(a, b, z, paint)
        if top is not None:
            centre = outline.mean(0)
            along, across = (outline[1] - outline[0]) / 2, (outline[2] - outline[1]) / 2
            self.slab(centre, along, across, z[1], top)
        self.shadows.append((outline, z[1]))

    def spire(
        self, outline: Floats, z: tuple[float, float], paint: Paint, taper: float = 1.0
    ) -> None:
        """A roof over a regular outline: as many faces, narrowing by `taper` towards the axis."""
        for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            self.wall(a, b, z, paint, lean=_apothem(outline) * taper, taper=taper)

    def soffit(self, outline: Floats, z: float, depth: float, paint: Paint) -> None:
        """The underside of what stands out by `depth` over the walls, along a regular outline."""
        for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            inside = np.array((a[1] - b[1], b[0] - a[0], 0.0)) / np.linalg.norm(b - a) * depth
            taper = depth / _apothem(outline)
            self._add(np.append(b, z) + inside, np.append(a - b, 0.0), -inside, paint, taper)

    def gable(self, outline: Floats, z: tuple[float, float], roof: Paint, end: Paint) -> None:
        """A ridge roof over a rectangle; the ridge runs along its first side."""
        depth = float(np.linalg.norm(outline[2] - outline[1]))
        for side in (0, 2):
            a, b = outline[side], outline[(side + 1) % 4]
            self.wall(a, b, z, roof, lean=depth / 2)
        for side in (1, 3):
            self.wall(outline[side], outline[(side + 1) % 4], z, end, taper=1.0)


def regular(
    sides: int, radius: float, centre: Sequence[float] | Floats = (0, 0), turn_deg: float = 0.0
) -> Floats:
    """A regular outline (N, 2), counter-clockwise; `turn_deg` is the azimuth of its first
    corner.
    """
    angle = np.radians(turn_deg) + np.arange(sides) * 2 * np.pi / sides
    return np.asarray(centre) + radius * np.column_stack((np.cos(angle), np.sin(angle)))


def _apothem(outline: Floats) -> float:
    return float(np.linalg.norm((outline[0] + outline[1]) / 2 - outline.mean(0)))


def rectangle(centre: Floats, size: tuple[float, float], azimuth_deg: float) -> Floats:
    """A rectangle (4, 2), counter-clockwise; its first side is the one at +x, turned to the
    azimuth.
    """
    c, s = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
    x, y = size[0] / 2, size[1] / 2
    corners = np.array(((x, -y), (x, y), (-x, y), (-x, -y)))
    return np.asarray(centre) + corners @ np.array(((c, s), (-s, c)))


def polar(radius: float, azimuth_deg: float) -> Floats:
    """A place on the ground."""
    return radius * np.array((np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))))
