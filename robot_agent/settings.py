"""All settings of the agent: defaults, overlaid by file, environment and command line."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydantic_settings import SettingsConfigDict

from fleetpose.protocol.settings import Endpoints, Name, ProcessSettings
from fleetpose.robot_agent.cameras.bag.options import StampSource
from fleetpose.robot_agent.cameras.kinds import CameraKind
from fleetpose.robot_agent.cameras.replay import ReplayMode
from fleetpose.robot_agent.cameras.topics.options import UpSource
from fleetpose.rosmsg.live.names import name_of


class RobotSettings(ProcessSettings):
    """Settings of `robot-agent run`; in the environment `FLEETPOSE_ROBOT_NAME` and so on."""

    model_config = SettingsConfigDict(env_prefix="FLEETPOSE_ROBOT_")
    roles: ClassVar[tuple[str, ...]] = ("robot",)
    identified: ClassVar[Mapping[str, str]] = {"site": "site", "name": "name"}

    @model_validator(mode="before")
    @classmethod
    def _name(cls, given: dict[str, Any]) -> dict[str, Any]:
        """A robot without a name is called as its namespace is."""
        if given.get("name") or not given.get("namespace"):
            return given
        return given | {"name": name_of(str(given["namespace"]))}

    name: Name = Field(
        description="the robot's name, unique in its site; else config or namespace tells it"
    )
    site: Name = Field("demo", description="the fleet's site")
    connect: Endpoints = Field(
        ("tcp/127.0.0.1:7447",),
        description="endpoints of the router",
    )
    config: Path | None = Field(
        None,
        description="zenoh configuration (JSON5), replaces connect; for TLS and access control; "
        "where it says whose it is, name and site may be left out",
    )
    connect_timeout_s: float = Field(
        -1.0, description="wait so long for a router at the start; negative: for ever"
    )
    camera: CameraKind = Field(description="what the robot sees with, or whose recording it plays")
    data: str = Field(
        "",
        description="folder, bag, video, device (or left,right), or endpoint (ros: of the "
        "robot's router)",
    )
    calibration: Path | None = Field(None, description="stereo, rgbd: file; else beside the images")
    translation_unit: float | None = Field(
        None,
        gt=0,
        le=1000,
        description="stereo: metres that one of the calibration's translation is; else metres",
    )
    depth_scale: float | None = Field(
        None,
        gt=0,
        le=1e6,
        description="rgbd: steps of the depth images per metre; else what the layout says",
    )
    size: Annotated[str, Field(pattern=r"^[1-9]\d{1,4}x[1-9]\d{1,4}$")] | None = Field(
        None, description="devices: WIDTHxHEIGHT of the images, both eyes where side by side"
    )
    fps: float | None = Field(None, gt=0, le=1000, description="devices, videos: frames per second")
    fourcc: Annotated[str, Field(pattern=r"^[!-~]{4}$")] | None = Field(
        None, description="devices: coding of the images, e.g. MJPG"
    )
    eyes: Literal["side-by-side", "top-bottom"] = Field(
        "side-by-side", description="devices, videos: how both eyes lie in one image"
    )
    max_skew_ms: float | None = Field(
        None,
        gt=0,
        le=1000,
        description="two devices, bags, ros: what is taken further apart is dropped; else 10 of "
        "two eyes, 20 of colour and depth",
    )
    namespace: str = Field(
        "",
        description="bags, ros: of the robot's topics, e.g. /r1, else all; names the robot where "
        "name does not",
    )
    image: str = Field("", description="bags, ros: the topic of colours; else by type and name")
    depth: str = Field("", description="bags, ros: the topic of depths; else by type and name")
    left: str = Field("", description="bags, ros: the topic of the left eye; else by type and name")
    right: str = Field(
        "", description="bags, ros: the topic of the right eye; else by type and name"
    )
    cloud: str = Field("", description="bags, ros: the topic of a cloud, in place of depths")
    base: str = Field("base_link", description="bags, ros: the frame of the robot's body in tf")
    up: UpSource = Field(
        "auto",
        description="bags, ros: what tells where up is: odom, imu (an accelerometer at rest), tf "
        "(its uppermost frame), none, or auto (imu or odom, where they can)",
    )
    domain: int = Field(0, ge=0, le=232, description="ros: ROS_DOMAIN_ID")
    stamps: StampSource = Field(
        "header",
        description="bags: whose time counts, of the drivers (header) or the recorder (receive)",
    )
    speed: float = Field(1.0, gt=0, le=1000, description="bags: how fast they are played")
    clouds: str | None = Field(None, description="kind of clouds; for posed views")
    view: str | None = Field(
        None, description="the one view to show; for posed views and reconstructions"
    )
    axes: Literal["robot", "optical"] = Field(
        "robot",
        description="clouds: robot (x ahead, y left, z up) or optical (x right, y down, z ahead)",
    )
    metres_per_unit: float = Field(
        1.0, gt=0, le=1e6, description="for reconstructions, whose scale is arbitrary"
    )
    replay: ReplayMode = Field(
        "once",
        description="recordings: once, loop, pingpong or hold (the first view again and again)",
    )
    rate_hz: float = Field(1.0, gt=0, le=100, description="frames per second")
    max_salient: int = Field(1600, ge=10, le=20_000, description="salient points per view")
    jpeg_quality: int = Field(85, ge=1, le=100, description="of the images that operators see")
    keep_views: int = Field(30, ge=1, le=1000, description="views that can still be asked for")
    takeover: bool = Field(False, description="start even if another agent has the name")
    opencv_threads: int = Field(0, ge=0, le=256, description="0: as OpenCV likes")
