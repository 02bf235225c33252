"""A map as a PLY file: binary, a point and the robot that saw it."""

from pathlib import Path

import numpy as np

from fleetpose.formats.ply import write_ply
from fleetpose.pose_server.mapping.colours import robot_colours
from fleetpose.pose_server.mapping.merging import FleetMap

_VERTEX = np.dtype(
    [(axis, "<f4") for axis in "xyz"]
    + [(colour, "u1") for colour in ("red", "green", "blue")]
    + [("robot", "<u2")]
)


def write_map(path: Path, fleet_map: FleetMap) -> None:
    """Writes a map; `comment robot NUMBER NAME` says whose a vertex's `robot` is.

    Raises:
        OSError: it cannot be written.
    """
    vertices = np.empty(len(fleet_map.points), _VERTEX)
    for k, axis in enumerate("xyz"):
        vertices[axis] = fleet_map.points[:, k]
    colours = robot_colours(len(fleet_map.robots))[fleet_map.robot]
    for k, colour in enumerate(("red", "green", "blue")):
        vertices[colour] = colours[:, k]
    vertices["robot"] = fleet_map.robot
    comments = (
        "fleetpose: fleet frame, metres; one point per robot and voxel of "
        f"{fleet_map.voxel_m:.4g} m",
        *(f"robot {number} {name}" for number, name in enumerate(fleet_map.robots)),
    )
    write_ply(path, vertices, comments)
