"""fleetpose: where every robot of a fleet is relative to the others.

What a robot's own program needs:

    from fleetpose import Camera, FleetRobot, SessionSettings

Names are loaded when they are first used, so that no process loads what it does not need.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fleetpose.protocol.errors import FleetPoseError as FleetPoseError
    from fleetpose.protocol.messages import Camera as Camera
    from fleetpose.protocol.messages import NoiseModel as NoiseModel
    from fleetpose.protocol.messages import RelativePose as RelativePose
    from fleetpose.protocol.messages import RobotPose as RobotPose
    from fleetpose.protocol.transport import SessionSettings as SessionSettings
    from fleetpose.robot_agent.cameras.base import DepthImage as DepthImage
    from fleetpose.robot_agent.cameras.base import DisparityImage as DisparityImage
    from fleetpose.robot_agent.cameras.base import Frame as Frame
    from fleetpose.robot_agent.cameras.base import ScatteredPoints as ScatteredPoints
    from fleetpose.robot_agent.client import FleetRobot as FleetRobot
    from fleetpose.robot_agent.sender import SenderSettings as SenderSettings

_MODULES = {
    "Camera": "protocol.messages",
    "DepthImage": "robot_agent.cameras.base",
    "DisparityImage": "robot_agent.cameras.base",
    "FleetPoseError": "protocol.errors",
    "FleetRobot": "robot_agent.client",
    "Frame": "robot_agent.cameras.base",
    "NoiseModel": "protocol.messages",
    "RelativePose": "protocol.messages",
    "RobotPose": "protocol.messages",
    "ScatteredPoints": "robot_agent.cameras.base",
    "SenderSettings": "robot_agent.sender",
    "SessionSettings": "protocol.transport",
}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"fleetpose has no '{name}'; there are {', '.join(_MODULES)}")
    return getattr(import_module(f"fleetpose.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
