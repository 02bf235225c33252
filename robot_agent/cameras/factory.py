"""Opens a camera by its kind.

A new kind is one new module here with a function `open_camera(source, replay)`.
"""

from importlib import import_module
from typing import Literal

from robot_agent.cameras.base import Camera

CameraKind = Literal["rgbd", "views", "stereo", "synthetic"]


def open_camera(
    kind: CameraKind,
    source: str,
    replay: str,
    clouds: str | None = None,
    view: str | None = None,
) -> Camera:
    """Opens a camera.

    Args:
        kind: the name of its module in `robot_agent.cameras`; only that one is imported.
        source: a folder or an endpoint, whatever the kind reads.
        replay: `once`, `loop`, `pingpong` or `hold`, for recordings.
        clouds: posed views only, which kind of clouds to take.
        view: posed views only, the one view to take.

    Raises:
        FleetPoseError: the source cannot be read or is not calibrated.
    """
    module = import_module(f"robot_agent.cameras.{kind}")
    options = {"clouds": clouds, "view": view} if kind == "views" else {}
    return module.open_camera(source, replay, **options)
