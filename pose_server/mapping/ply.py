"""A map as a PLY file: binary, a point and the robot that saw it."""

from pathlib import Path

import numpy as np

from fleetpose.pose_server.mapping.colours import robot_colours
from fleetpose.pose_server.mapping.merging import FleetMap

_VERTEX = np.dtype(
    [(axis, "<f4") for axis in "xyz"]
    + [(colour, "u1") for colour in ("red", "green", "blue")]
    + [("robot", "<u2")]
)
_PLY_TYPES = {"<f4": "float", "|u1": "uchar", "<u2": "ushort"}


def write_ply(path: Path, fleet_map: FleetMap) -> None:
    """Writes a map; `comment robot NUMBER NAME` says whose a vertex's `robot` is.

    Own code: Open3D writes further properties of a vertex, but no comments.

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
    header = (
        "ply",
        "format binary_little_endian 1.0",
        "comment fleetpose: fleet frame, metres; one point per robot and voxel of "
        f"{fleet_map.voxel_m:.4g} m",
        *(f"comment robot {number} {name}" for number, name in enumerate(fleet_map.robots)),
        f"element vertex {len(vertices)}",
        *(f"property {_PLY_TYPES[_VERTEX[name].str]} {name}" for name in _VERTEX.names or ()),
        "end_header",
    )
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(vertices.tobytes())
