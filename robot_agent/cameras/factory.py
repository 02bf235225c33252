"""Opens a camera by its kind.

A new kind is one new module here with a function `open_camera(source, replay)`; options of its own
are named in `_OPTIONS`. Bundler's folders had a kind of their own, whose name goes on working.
"""

import threading
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from fleetpose.robot_agent.cameras.base import Camera
from fleetpose.robot_agent.cameras.kinds import CameraKind

_MODULES: dict[CameraKind, str] = {
    "rgbd": "rgbd.recording",
    "views": "folders.views",
    "reconstruction": "folders.reconstruction",
    "bundler": "folders.reconstruction",
    "cloud": "folders.cloud",
    "stereo": "stereo.matching",
    "bag": "bag.camera",
    "ros": "ros.camera",
    "synthetic": "synthetic",
}
_OPTIONS = {
    "views": ("clouds", "view"),
    "reconstruction": ("view", "metres_per_unit"),
    "cloud": ("axes", "metres_per_unit"),
    "stereo": ("calibration", "video", "stop", "translation_unit"),
    "rgbd": ("calibration", "depth_scale"),
    "bag": ("calibration", "bag", "stop", "translation_unit"),
    "ros": ("calibration", "ros", "stop", "translation_unit", "waiting"),
}


def open_camera(
    kind: CameraKind,
    source: str,
    replay: str,
    *,
    clouds: str | None = None,
    view: str | None = None,
    metres_per_unit: float = 1.0,
    axes: Literal["robot", "optical"] = "robot",
    calibration: Path | None = None,
    video: Any = None,
    stop: threading.Event | None = None,
    translation_unit: float | None = None,
    depth_scale: float | None = None,
    bag: Any = None,
    ros: Any = None,
    waiting: Callable[[str], None] = lambda status: None,
) -> Camera:
    """Opens a camera.

    Args:
        kind: only its module is imported; `bundler` is `reconstruction`.
        source: a folder, a file, a device or an endpoint, whatever the kind reads.
        replay: `once`, `loop`, `pingpong` or `hold`, for recordings.
        clouds: posed views only, which kind of clouds to take.
        view: posed views and reconstructions, the one view to take.
        metres_per_unit: reconstructions, whose scale is arbitrary, and clouds.
        axes: clouds only, `robot` or `optical`.
        calibration: stereo, rgbd, bags and ros, its file.
        video: stereo only, `robot_agent.cameras.stereo.video.VideoSettings`.
        stop: stereo, bags and ros, ends the waiting for a device or the next frame.
        translation_unit: stereo, bags and ros, metres that one of the calibration's translation is.
        depth_scale: rgbd only, steps of its depth images per metre.
        bag: bags only, `robot_agent.cameras.bag.options.BagOptions`.
        ros: live robots only, `robot_agent.cameras.ros.options.RosOptions`.
        waiting: live robots only, is told at least once a second what is waited for.

    Raises:
        FleetPoseError: the source cannot be read or is not calibrated.
    """
    given = {
        "clouds": clouds,
        "view": view,
        "metres_per_unit": metres_per_unit,
        "axes": axes,
        "calibration": calibration,
        "video": video,
        "stop": stop,
        "translation_unit": translation_unit,
        "depth_scale": depth_scale,
        "bag": bag,
        "ros": ros,
        "waiting": waiting,
    }
    name = "reconstruction" if kind == "bundler" else kind
    module = import_module(f"fleetpose.robot_agent.cameras.{_MODULES[kind]}")
    options = {option: given[option] for option in _OPTIONS.get(name, ())}
    return module.open_camera(source, replay, **options)
