"""`pose-ros`: the command line of the way to ROS 2."""

from typing import Any

from fleetpose.protocol.commands import Version, command_line, examples, require, run_command
from fleetpose.protocol.settings import DumpSettings, SettingsFile, with_options
from fleetpose.ros_bridge.settings import BridgeSettings

app = command_line()


@app.callback()
def _ros(version: Version = False) -> None:
    """The fleet's poses in ROS 2, without ROS here: nodes speak rmw_zenoh, or DDS behind its
    bridge.
    """


@app.command(epilog=examples("pose-ros bridge --robot r1=/r1 --connect tcp/192.168.1.10:7447"))
@with_options(BridgeSettings)
def bridge(
    *,
    settings: SettingsFile = None,
    dump_settings: DumpSettings = False,
    **given: Any,
) -> None:
    """Joins the robots' tf trees under a frame `fleet` and publishes their poses, until Ctrl-C.

    Of each robot that is located: /fleet/NAME/pose (PoseWithCovarianceStamped),
    /fleet/NAME/odometry, and its own frames, behind its name, on --tf. Nothing is told of others.
    """
    loaded = BridgeSettings.load(settings, given)
    if dump_settings:
        print(loaded.as_toml(), end="")
        return
    require("ros")
    from fleetpose.ros_bridge.running import run_bridge

    run_bridge(loaded)


def main() -> None:
    """Runs the command line; what a user can mend is one sentence and exit code 2."""
    run_command(app, "pose-ros", "ros")


if __name__ == "__main__":
    main()
