"""The fleet in 3D as a picture: from above and from a slant, by matplotlib, without a display."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.mapping.colours import robot_colours
from fleetpose.pose_server.mapping.drawing import (
    HALO,
    LINKS,
    OUTSIDE_ELLIPSOID,
    draw_cameras,
    draw_links,
    draw_names,
    kind_of,
)
from fleetpose.pose_server.mapping.projection import Projection, aslant, from_above
from fleetpose.pose_server.mapping.raster import dots
from fleetpose.pose_server.mapping.scene import Scene

Floats = npt.NDArray[np.floating]

_DPI, _FINER = 160, 2  # of the picture, and pixels of the image of points in one of these
_WIDTH_IN, _HEIGHT_IN = 12.0, (2.5, 7.5)  # of both panels together; of each, least and most
_LEFT_IN, _BETWEEN_IN, _RIGHT_IN, _BELOW_IN, _ABOVE_IN = 0.15, 0.75, 0.2, 0.85, 0.35
_POINTS = 300_000  # drawn, evenly chosen: more would cover each other at this size
_OUTSIDE = 1.0  # percent of the points at either end of an axis that may lie beyond the picture
_MARGIN = 0.085  # around what is shown, share of its longer side
_HAZE_ASLANT, _HAZE_ABOVE = 0.6, 0.4  # how far the farthest points fade
_FRUSTUM = (0.015, 0.05)  # depth of a camera's frustum, share of the extent, least and most
_FRUSTUM_APART = 0.45  # the same, share of the distance between neighbours
_NAME_AWAY = 0.018  # of a name from its camera, share of the extent, at least
_NAMED = 24  # more robots are named in the slanted panel only, and small
_LARGEST_ELLIPSE = 0.04  # smaller ones are drawn up to 100 times as large, share of the extent


@dataclass(frozen=True)
class _Panel:
    """A way to look, and what of the plane is shown: lower and upper corner (2, 2), metres."""

    projection: Projection
    box: Floats
    haze: float

    @property
    def size(self) -> Floats:
        """Width and height, metres."""
        return self.box[1] - self.box[0]

    @property
    def aspect(self) -> float:
        """Width by height."""
        return float(self.size[0] / self.size[1])


def draw(scene: Scene, path: Path, title: str = "") -> None:
    """Draws a fleet, in the format that the file's ending names.

    Args:
        scene: one camera at least.
        path: the file.
        title: above both panels.

    Raises:
        OSError: the file cannot be written.
    """
    slant = aslant(np.stack([camera.T_fleet_camera for camera in scene.cameras]))
    shown = _shown(scene)
    panels = (
        _Panel(slant, _box(scene, shown, slant), _HAZE_ASLANT),
        _Panel(from_above(), _box(scene, shown, from_above()), _HAZE_ABOVE),
    )
    figure, axes, height_in = _figure(panels, title)
    extent = max(float(panel.size.max()) for panel in panels)
    enlarged = _enlarged(scene, extent)
    for one, panel in zip(axes, panels, strict=True):
        _draw_points(one, scene, shown, panel, height_in)
        draw_links(one, scene, panel.projection)
        draw_cameras(one, scene, panel.projection, _frustum_m(scene, extent), enlarged)
        one.set(xlim=panel.box[:, 0], ylim=panel.box[:, 1])
    away_m = max(0.6 * _frustum_m(scene, extent), _NAME_AWAY * extent)
    few = len(scene.cameras) <= _NAMED
    draw_names(axes[0], scene, slant, away_m, 8.0 if few else 5.0)
    if few:
        draw_names(axes[1], scene, from_above(), away_m, 8.0)
    _frame_slanted(axes[0], panels[0])
    _frame_from_above(axes[1])
    _legend(figure, scene, enlarged)
    figure.savefig(path, facecolor="white")


def _figure(panels: Sequence[_Panel], title: str) -> tuple[Figure, list[Any], float]:
    """A figure, an axes for each panel, and their height in inches: both show metres at one
    height, and nothing has to be fitted afterwards.
    """
    aspects = [panel.aspect for panel in panels]
    height = float(np.clip(_WIDTH_IN / sum(aspects), *_HEIGHT_IN))
    above = _ABOVE_IN + (0.3 if title else 0.0)
    full = np.array(
        (
            _LEFT_IN + _BETWEEN_IN + _RIGHT_IN + height * sum(aspects),
            _BELOW_IN + height + above,
        )
    )
    figure = Figure(figsize=tuple(full), dpi=_DPI)
    FigureCanvasAgg(figure)
    axes, left = [], _LEFT_IN
    for aspect in aspects:
        corner, size = np.array((left, _BELOW_IN)), np.array((height * aspect, height))
        axes.append(figure.add_axes((*(corner / full), *(size / full))))
        left += height * aspect + _BETWEEN_IN
    if title:
        figure.text(0.5, 1.0 - 0.2 / full[1], title, ha="center", va="center", fontsize=11)
    return figure, axes, height


def _shown(scene: Scene) -> npt.NDArray[np.intp]:
    """Which points are drawn."""
    count = len(scene.fleet_map.points)
    if count <= _POINTS:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, _POINTS, replace=False))


def _box(scene: Scene, shown: npt.NDArray[np.intp], projection: Projection) -> Floats:
    """(2, 2) lower and upper corner of what a panel shows: all cameras, and most points."""
    points = projection.flat(scene.fleet_map.points[shown])
    cameras = projection.flat(np.stack([c.T_fleet_camera[:3, 3] for c in scene.cameras]))
    low, high = cameras.min(axis=0), cameras.max(axis=0)
    if len(points):
        ends = np.percentile(points, (_OUTSIDE, 100.0 - _OUTSIDE), axis=0)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    margin = _MARGIN * max(float((high - low).max()), 1e-3)
    return np.stack((low - margin, high + margin))


def _frustum_m(scene: Scene, extent_m: float) -> float:
    """Depth of the frusta: small where cameras stand close together."""
    eyes = np.stack([camera.T_fleet_camera[:3, 3] for camera in scene.cameras])
    apart = np.linalg.norm(eyes[:, None] - eyes[None], axis=2) + np.diag(len(eyes) * [np.inf])
    near_m = float(np.median(apart.min(axis=1)))
    least, most = (share * extent_m for share in _FRUSTUM)
    return float(np.clip(_FRUSTUM_APART * near_m, least, most))


def _draw_points(
    axes: Any, scene: Scene, shown: npt.NDArray[np.intp], panel: _Panel, height_in: float
) -> None:
    points, robot = scene.fleet_map.points[shown], scene.fleet_map.robot[shown]
    rows, columns = (round(height_in * _DPI * _FINER * share) for share in (1.0, panel.aspect))
    image = dots(
        panel.projection.flat(points),
        panel.projection.nearness(points),
        robot_colours(len(scene.fleet_map.robots))[robot] / 255.0,
        panel.box,
        (rows, columns),
        panel.haze,
    )
    extent = tuple(panel.box.T.ravel())
    axes.imshow(image, origin="lower", extent=extent, aspect="auto", zorder=1)


def _frame_from_above(axes: Any) -> None:
    axes.set_title("from above", fontsize=10)
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.5, zorder=0)
    axes.set_axisbelow(True)


def _frame_slanted(axes: Any, panel: _Panel) -> None:
    """No ticks, since they would be of no axis: a bar of round metres, and the three axes."""
    axes.set_title("from a slant", fontsize=10)
    axes.set(xticks=[], yticks=[])
    low, size = panel.box[0], panel.size
    length = _round_m(0.25 * float(size[0]))
    start = low + 0.04 * size
    axes.plot([start[0], start[0] + length], [start[1]] * 2, "k-", linewidth=2.5, zorder=7)
    axes.text(start[0] + length / 2, start[1] + 0.015 * size[1], f"{length:g} m", ha="center",
              va="bottom", fontsize=9, zorder=7, path_effects=HALO)  # fmt: skip
    corner = np.array((low[0] + 0.9 * size[0], low[1] + 0.1 * size[1]))
    for name, axis in zip("xyz", 0.07 * float(size.min()) * np.eye(3), strict=True):
        tip = corner + panel.projection.flat(axis[None])[0]
        axes.plot(*np.stack((corner, tip)).T, "-", color="#33404f", linewidth=1.2, zorder=7)
        axes.text(*(corner + 1.35 * (tip - corner)), name, fontsize=8, ha="center", va="center",
                  zorder=7, path_effects=HALO)  # fmt: skip


def _round_m(length_m: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not longer."""
    decade = 10.0 ** np.floor(np.log10(length_m))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= length_m))


def _enlarged(scene: Scene, extent_m: float) -> int:
    """How many times as large ellipsoids are drawn, so that the largest can be seen."""
    sigmas = [
        np.linalg.eigvalsh(c.covariance)[-1] for c in scene.cameras if c.covariance is not None
    ]
    reach = 2 * (chi2_limit(OUTSIDE_ELLIPSOID, 3) * max([*sigmas, 0.0])) ** 0.5
    fits = [
        times for times in (100, 50, 20, 10, 5, 2) if times * reach <= _LARGEST_ELLIPSE * extent_m
    ]
    return fits[0] if fits else 1


def _legend(figure: Figure, scene: Scene, enlarged: int) -> None:
    """One line below both panels."""
    there = {kind_of(link) for link in scene.links}
    handles = [
        Line2D([], [], color=colour, linestyle=style, label=label)
        for kind, (colour, style, label) in LINKS.items()
        if kind in there
    ]
    times = "" if enlarged == 1 else f", {enlarged} times as large"
    points, robots = len(scene.fleet_map.points), len(scene.cameras)
    handles += [
        Line2D([], [], ls="", marker="o", ms=9, mfc="#dddddd", mec="#444444",
               label=f"95 % of the position{times}"),
        Line2D([], [], ls="", marker=".", color="#666666",
               label=f"{points} points of {robots} robots, a colour each"),
    ]  # fmt: skip
    if scene.missing:
        handles.append(Line2D([], [], ls="", label=f"not located: {_some(scene.missing)}"))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=8.5,
                  frameon=False)  # fmt: skip


def _some(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 5 else f"{len(names)} robots"
