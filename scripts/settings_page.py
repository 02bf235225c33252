"""Prints the page of all settings, made of the classes that the processes read.

python scripts/settings_page.py > docs/settings.md
"""

import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from pydantic.fields import FieldInfo

from fleetpose.hmi_client.cli.commands import app as hmi_app
from fleetpose.hmi_client.settings import ClientSettings
from fleetpose.pose_server.__main__ import app as server_app
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.settings import ProcessSettings
from fleetpose.robot_agent.__main__ import app as robot_app
from fleetpose.robot_agent.settings import RobotSettings
from fleetpose.ros_bridge.__main__ import app as ros_app
from fleetpose.ros_bridge.settings import BridgeSettings

HEAD = """# Settings

Every setting has a default that works, but for a robot's `name` and `camera`. It can stand in a
TOML file, in the environment and on the command line. The command line goes before the
environment, and that before the file. What is unknown or impossible is refused in a sentence that
names it.

    pose-server run --dump-settings > server.toml    # all settings in use, each with what it means
    pose-server run --settings server.toml

`robot-agent run`, `pose-server run` and `hmi-client` know both options. `--dump-config` is the
older name of `--dump-settings`. In the environment a setting has its name in capitals behind the
prefix: `FLEETPOSE_SERVER_STATE_DIR`. A list may stand there as JSON, or with commas or spaces.

This page is printed by `python scripts/settings_page.py`."""

_BOUNDS = {"gt": "above {}", "ge": "at least {}", "lt": "below {}", "le": "at most {}"}


def page() -> str:
    """The page, as it should stand in docs/settings.md."""
    robot, server = typer.main.get_command(robot_app), typer.main.get_command(server_app)
    ros = typer.main.get_command(ros_app)
    parts = [
        HEAD,
        *_section("robot-agent run", RobotSettings, robot.commands["run"]),  # type: ignore[attr-defined]
        *_section("pose-server run", ServerSettings, server.commands["run"]),  # type: ignore[attr-defined]
        *_section("hmi-client", ClientSettings, typer.main.get_command(hmi_app)),
        *_section("pose-ros bridge", BridgeSettings, ros.commands["bridge"]),  # type: ignore[attr-defined]
    ]
    return "\n\n".join(parts) + "\n"


def _section(title: str, settings: type[ProcessSettings], command: Any) -> Iterator[str]:
    options = {one.name.removesuffix("_file"): one.opts[0] for one in command.params}
    prefix = settings.model_config.get("env_prefix", "")
    yield f"## {title}"
    yield f"In the environment with `{prefix}` before the name."
    rows = [
        " | ".join(
            (f"| `{name}`", f"`{options[name]}`", _default(field), _allowed(field), _meaning(field))
        )
        + " |"
        for name, field in settings.model_fields.items()
    ]
    head = ["| setting | option | default | allowed | meaning |", "|---|---|---|---|---|"]
    yield "\n".join([*head, *rows])


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    if field.default_factory is not None:
        return "by the machine"
    if isinstance(field.default, bool):
        return "on" if field.default else "off"
    if field.default in (None, "", ()):
        return ""
    many = isinstance(field.default, tuple)
    return f"`{', '.join(field.default) if many else field.default}`"


def _allowed(field: FieldInfo) -> str:
    choices = _choices(field.annotation)
    if choices:
        return ", ".join(f"`{one}`" for one in choices)
    return ", ".join(
        text.format(f"{getattr(bound, sign):.12g}")
        for bound in field.metadata
        for sign, text in _BOUNDS.items()
        if hasattr(bound, sign)
    )


def _choices(annotation: Any) -> tuple[str, ...]:
    """The words that a setting may be; none if it is no choice."""
    origin = get_origin(annotation)
    if origin is Literal:
        return tuple(map(str, get_args(annotation)))
    if origin in (Union, types.UnionType, Annotated):
        return _choices(get_args(annotation)[0])
    return ()


def _meaning(field: FieldInfo) -> str:
    return (field.description or "").replace("|", "\\|")


if __name__ == "__main__":
    print(page(), end="")
