"""All settings of the agent: defaults, overlaid by file, environment and command line."""

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, ValidationError
from pydantic_settings import (
    BaseSettings,
    JsonConfigSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import NAME_PATTERN
from fleetpose.robot_agent.cameras.factory import CameraKind
from fleetpose.robot_agent.cameras.replay import ReplayMode

CAMERA_KINDS: tuple[str, ...] = get_args(CameraKind)
REPLAY_MODES: tuple[str, ...] = get_args(ReplayMode)
Name = Annotated[str, Field(pattern=NAME_PATTERN)]


class SettingsRefusedError(FleetPoseError):
    """A setting is missing or impossible; the sentence names it."""


class RobotSettings(BaseSettings):
    """Settings of `robot-agent run`; in the environment `FLEETPOSE_ROBOT_NAME` and so on."""

    model_config = SettingsConfigDict(env_prefix="FLEETPOSE_ROBOT_", extra="forbid")

    name: Name = Field(description="the robot's name, unique in its site")
    site: Name = "demo"
    connect: tuple[str, ...] = Field(
        ("tcp/127.0.0.1:7447",), description="endpoints of the router; JSON list in the environment"
    )
    config: Path | None = Field(
        None,
        description="zenoh configuration (JSON5), replaces connect; for TLS and access control",
    )
    connect_timeout_s: float = Field(10.0, description="wait for the router; negative: for ever")
    camera: CameraKind = Field(description="kind of camera")
    data: str = Field("", description="folder, video, device (or left,right), or endpoint")
    calibration: Path | None = Field(None, description="stereo: file; else beside the images")
    size: Annotated[str, Field(pattern=r"^[1-9]\d{1,4}x[1-9]\d{1,4}$")] | None = Field(
        None, description="devices: WIDTHxHEIGHT of the images, both eyes where side by side"
    )
    fps: float | None = Field(None, gt=0, le=1000, description="devices, videos: frames per second")
    fourcc: Annotated[str, Field(pattern=r"^[!-~]{4}$")] | None = Field(
        None, description="devices: coding of the images, e.g. MJPG"
    )
    max_skew_ms: float = Field(
        10.0, gt=0, le=1000, description="two devices: images taken further apart are dropped"
    )
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
    replay: ReplayMode = "once"
    rate_hz: float = Field(1.0, gt=0, le=100)
    max_salient: int = Field(1600, ge=10, le=20_000, description="salient points per view")
    jpeg_quality: int = Field(85, ge=1, le=100)
    keep_views: int = Field(30, ge=1, le=1000, description="views that can still be asked for")
    takeover: bool = Field(False, description="start even if another agent has the name")
    opencv_threads: int = Field(0, ge=0, le=256, description="0: as OpenCV likes")

    @classmethod
    def load(cls, file: Path | None, given: dict[str, Any]) -> "RobotSettings":
        """Builds the settings.

        Args:
            file: JSON as `--dump-config` prints it.
            given: what the command line gave; None counts as not given.

        Raises:
            SettingsRefusedError: one is missing or impossible.
        """
        if file is not None and not file.is_file():
            raise SettingsRefusedError(f"settings file {file} does not exist")

        class WithFile(cls):
            model_config = SettingsConfigDict(json_file=file, json_file_encoding="utf-8")

            @classmethod
            def settings_customise_sources(
                cls,
                settings_cls: type[BaseSettings],
                init_settings: PydanticBaseSettingsSource,
                env_settings: PydanticBaseSettingsSource,
                dotenv_settings: PydanticBaseSettingsSource,
                file_secret_settings: PydanticBaseSettingsSource,
            ) -> tuple[PydanticBaseSettingsSource, ...]:
                return init_settings, env_settings, JsonConfigSettingsSource(settings_cls)

        try:
            return WithFile(**{k: v for k, v in given.items() if v is not None})
        except ValidationError as error:
            first = error.errors()[0]
            setting = ".".join(str(part) for part in first["loc"])
            raise SettingsRefusedError(f"setting '{setting}': {first['msg']}") from error
        except (SettingsError, ValueError) as error:
            raise SettingsRefusedError(f"settings cannot be read: {error}") from error
