"""What is drawn over the points: links, cameras, how well their places are known, names."""

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.patheffects import withStroke

from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.mapping.colours import robot_colours
from fleetpose.pose_server.mapping.projection import Projection
from fleetpose.pose_server.mapping.scene import MapCamera, MapLink, Scene

Floats = npt.NDArray[np.floating]

OUTSIDE_ELLIPSOID = 0.05
"""Probability that a camera is outside of its ellipsoid, by its covariance."""
LINKS: dict[str, tuple[str, Any, str]] = {
    "verified": ("#00694d", "-", "verified link"),
    "plausible": ("#8a5a00", "--", "plausible link"),
    "ambiguous": ("#a33c00", ":", "contradicted link"),
    "clicks": ("#1f5fa8", "-.", "link by clicks"),
}
HALO = [withStroke(linewidth=2.0, foreground="white")]
"""Behind words, so that they are read on points and lines."""


def draw_links(axes: Any, scene: Scene, projection: Projection) -> None:
    """Lines between cameras, by verdict."""
    for kind, (colour, style, _) in LINKS.items():
        ends = [
            projection.flat(np.stack((link.a, link.b)))
            for link in scene.links
            if kind_of(link) == kind
        ]
        axes.add_collection(
            LineCollection(
                ends, colors=colour, linestyles=style, linewidths=0.9, alpha=0.6, zorder=2
            )
        )


def kind_of(link: MapLink) -> str:
    """Which of `LINKS` a link is drawn as."""
    return "clicks" if link.clicks else link.verdict


def draw_cameras(
    axes: Any, scene: Scene, projection: Projection, size_m: float, enlarged: int
) -> None:
    """Frusta, the ways that the cameras came, and how well their places are known."""
    colours = robot_colours(len(scene.fleet_map.robots)) / 255.0
    own = [colours[camera.robot] for camera in scene.cameras]
    faces = [_frustum(camera, projection, size_m) for camera in scene.cameras]
    axes.add_collection(
        PolyCollection([tips for _, tips in faces], facecolors=own, alpha=0.25, zorder=3)
    )
    lines = [line for eye, tips in faces for line in _outlines(eye, tips)]
    darks = np.repeat(0.6 * np.array(own), len(lines) // len(faces), axis=0)
    axes.add_collection(LineCollection(lines, colors=darks, linewidths=1.1, zorder=4))
    for camera, colour in zip(scene.cameras, own, strict=True):
        if len(camera.path) > 1:
            path = projection.flat(camera.path).T
            axes.plot(*path, ".-", color=0.6 * colour, linewidth=0.8, ms=2.5, zorder=3)
    _draw_ellipsoids(axes, scene, projection, enlarged)


def _frustum(camera: MapCamera, projection: Projection, size_m: float) -> tuple[Floats, Floats]:
    """Where the eye (2,) and the corners (4, 2) of a frustum are in the picture."""
    T = camera.T_fleet_camera
    tips = (size_m * camera.corners) @ T[:3, :3].T + T[:3, 3]
    return projection.flat(T[None, :3, 3])[0], projection.flat(tips)


def _outlines(eye: Floats, tips: Floats) -> list[Floats]:
    """Lines of a frustum: four edges, and the rim of the image."""
    return [*(np.stack((eye, tip)) for tip in tips), np.vstack((tips, tips[:1]))]


def _draw_ellipsoids(axes: Any, scene: Scene, projection: Projection, enlarged: int) -> None:
    """Outlines of what holds 95 % of each position."""
    reach = enlarged * chi2_limit(OUTSIDE_ELLIPSOID, 3) ** 0.5
    colours = robot_colours(len(scene.fleet_map.robots)) / 255.0
    known = [
        (camera, projection.ellipse(camera.covariance))
        for camera in scene.cameras
        if camera.covariance is not None
    ]
    if not known:
        return
    large, small, angles = np.array([ellipse for _, ellipse in known]).T
    own = np.array([colours[camera.robot] for camera, _ in known])
    faint = np.hstack((own, np.full((len(own), 1), 0.2)))
    axes.add_collection(
        EllipseCollection(
            2 * reach * large, 2 * reach * small, angles, units="xy",
            offsets=projection.flat(np.stack([c.T_fleet_camera[:3, 3] for c, _ in known])),
            offset_transform=axes.transData, facecolors=faint,
            edgecolors=0.4 * own, linewidths=0.8, zorder=5,
        )
    )  # fmt: skip


def draw_names(axes: Any, scene: Scene, projection: Projection, away_m: float, size: float) -> None:
    """Behind the cameras, where no frustum is."""
    for camera in scene.cameras:
        T = camera.T_fleet_camera
        eye, ahead = projection.flat(np.stack((T[:3, 3], T[:3, 3] + T[:3, 2])))
        back = (eye - ahead) / max(float(np.linalg.norm(eye - ahead)), 1e-9)
        axes.text(
            *(eye + away_m * back), scene.fleet_map.robots[camera.robot],
            fontsize=size, ha="center", va="center", color="#1b232d", zorder=6,
            path_effects=HALO,
        )  # fmt: skip
