"""Settings of the bridge to ROS 2; in the environment `FLEETPOSE_BRIDGE_SITE` and so on."""

import re
from pathlib import Path
from threading import Event
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field, model_validator
from pydantic_settings import NoDecode, SettingsConfigDict

from fleetpose.protocol.keys import checked_name
from fleetpose.protocol.session.opening import FOR_EVER, SessionSettings
from fleetpose.protocol.settings import Endpoints, Name, ProcessSettings, checked_text, listed

_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def _checked_robot(text: str) -> str:
    """`r1=/r1`, or `r1` for `r1=/r1`."""
    name, _, namespace = text.partition("=")
    namespace = namespace or f"/{name}"
    if not _TOPIC.fullmatch(namespace):
        raise ValueError(f"'{text}': write NAME=/NAMESPACE, e.g. r1=/r1")
    return f"{checked_name(name)}={namespace}"


def _checked_topic(text: str) -> str:
    if not _TOPIC.fullmatch(text):
        raise ValueError(f"'{text}' is no topic, e.g. /tf")
    return text


Robots = Annotated[
    tuple[Annotated[str, checked_text(_checked_robot)], ...], NoDecode, BeforeValidator(listed)
]
Names = Annotated[tuple[Name, ...], NoDecode, BeforeValidator(listed)]


class BridgeSettings(ProcessSettings):
    """Whose frames and poses are carried to ROS 2, and where."""

    model_config = SettingsConfigDict(env_prefix="FLEETPOSE_BRIDGE_")
    roles: ClassVar[tuple[str, ...]] = ("observer", "operator")

    robot: Robots = Field(
        (), description="NAME=/NAMESPACE of a robot, once per robot; without namespace /NAME"
    )
    connect: Endpoints = Field(
        ("tcp/127.0.0.1:7447",), description="endpoints of the site's router"
    )
    site: Name = Field("demo", description="name of the site")
    config: Path | None = Field(None, description="zenoh configuration (JSON5), replaces connect")
    ros: Endpoints = Field(
        (), description="endpoints of the router of rmw_zenoh; if not set, the site's"
    )
    domain: int = Field(0, ge=0, le=232, description="ROS_DOMAIN_ID")
    base: str = Field("base_link", min_length=1, description="the robots' body frame")
    tf: Annotated[str, checked_text(_checked_topic)] = Field(
        "/tf", description="topic of the joined tree"
    )
    map_odom: Names = Field(
        (), description="robots whose map is the fleet's frame: map -> odom in their own tf"
    )

    @model_validator(mode="after")
    def _check(self) -> "BridgeSettings":
        names = [one.partition("=")[0] for one in self.robot]
        spaces = [one.partition("=")[2] for one in self.robot]
        if not names:
            raise ValueError("no robot is named: --robot r1=/r1")
        if own := [space for space in spaces if f"{space}/".startswith("/fleet/")]:
            raise ValueError(f"{own[0]} is where the fleet's own topics are")
        if len(set(names)) < len(names) or len(set(spaces)) < len(spaces):
            raise ValueError("a robot, or a namespace, is named twice")
        if strangers := set(self.map_odom) - set(names):
            raise ValueError(f"--map-odom {sorted(strangers)[0]} is no --robot")
        return self

    @property
    def namespaces(self) -> dict[str, str]:
        """By the robots' names in the fleet."""
        pairs = (one.partition("=") for one in self.robot)
        return {name: namespace for name, _, namespace in pairs}

    @property
    def robots(self) -> list[str]:
        """Their names in the fleet."""
        return list(self.namespaces)

    def of_fleet(self, stop: Event) -> SessionSettings:
        """Of the session with the site; it waits for the router until it is stopped."""
        return SessionSettings(self.connect, (), self.config, FOR_EVER, stop)

    def of_ros(self, stop: Event) -> SessionSettings | None:
        """Of the session with ROS 2, None where it is the site's."""
        return SessionSettings(self.ros, (), None, FOR_EVER, stop) if self.ros else None
