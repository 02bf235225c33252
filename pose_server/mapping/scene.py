"""What a picture of the fleet shows: the map, the cameras, the links between them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.mapping.merging import FleetMap
from fleetpose.protocol.messages import Camera, Verdict

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class MapCamera:
    """Where a robot's camera was last.

    Attributes:
        robot: its place in the map's list.
        T_fleet_camera: (4, 4).
        covariance: (3, 3) of the position in the fleet frame; none where nobody knows it.
        corners: (4, 3) directions of the image's corners in the camera frame, 1 deep.
        path: (K, 3) positions of its keyframes, the oldest first.
    """

    robot: int
    T_fleet_camera: Floats
    covariance: Floats | None
    corners: Floats
    path: Floats


@dataclass(frozen=True)
class MapLink:
    """A link that the solution rests on: positions (3,) of two cameras, and how sure it is.

    Attributes:
        clicks: an operator's clicks are in it.
    """

    a: Floats
    b: Floats
    verdict: Verdict
    clicks: bool


@dataclass(frozen=True)
class Scene:
    """The fleet in 3D, z up.

    Attributes:
        missing: names of the robots that are not located, and so are not in the map.
    """

    fleet_map: FleetMap
    cameras: tuple[MapCamera, ...]
    links: tuple[MapLink, ...]
    missing: tuple[str, ...] = ()


def image_corners(K: Floats, width: int, height: int) -> Floats:
    """(4, 3) directions of an image's corners in the camera frame, 1 deep, in order around it."""
    u, v = width - 0.5, height - 0.5  # pixel centres are at integers
    corners = np.array([(-0.5, -0.5, 1.0), (u, -0.5, 1.0), (u, v, 1.0), (-0.5, v, 1.0)])
    return corners @ np.linalg.inv(K).T


def corners_of(camera: Camera) -> Floats:
    """The same of a camera on the wire."""
    return image_corners(camera.K, camera.width, camera.height)
