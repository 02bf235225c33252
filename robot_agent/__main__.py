"""`robot-agent`: the command line of the robot's process."""

import logging
import os
import signal
import threading
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fleetpose.protocol.commands import Version, command_line, examples, run_command
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.settings import DumpSettings, SettingsFile, with_options
from fleetpose.robot_agent.cameras.topics.options import UpSource
from fleetpose.robot_agent.settings import RobotSettings

app = command_line()

Calibration = Annotated[
    Path | None,
    typer.Option(help="Stereo: in any tool's layout. [default: beside the images]"),
]
Unit = Annotated[
    float | None,
    typer.Option(help="Metres that one of the calibration's translation is. [default: 1]"),
]
Size = Annotated[
    str | None, typer.Option(help="Devices: WIDTHxHEIGHT, both eyes where side by side.")
]
Fps = Annotated[float | None, typer.Option(help="Devices and videos: their frames per second.")]
Fourcc = Annotated[str | None, typer.Option(help="Devices: coding of images, e.g. MJPG.")]
Skew = Annotated[
    float | None,
    typer.Option(help="Two devices: images further apart are dropped. [default: 10]"),
]
Eyes = Annotated[
    Literal["side-by-side", "top-bottom"],
    typer.Option(help="How both eyes lie in one image of a device or video."),
]


@app.callback()
def _agent(version: Version = False) -> None:
    """A robot's process: camera to 3D points to the fleet."""


@app.command(
    epilog=examples(
        "robot-agent run --name r1 --camera rgbd --data recordings/kitchen",
        "robot-agent run --name r2 --camera stereo --data /dev/video0 \\",
        "    --calibration rig.yaml --connect tcp/192.168.1.10:7447",
    )
)
@with_options(RobotSettings, {"rate_hz": "--rate"})
def run(
    *,
    settings: SettingsFile = None,
    end_with_parent: Annotated[
        bool, typer.Option("--end-with-parent", help="End when the starting process does.")
    ] = False,
    dump_settings: DumpSettings = False,
    **given: Any,
) -> None:
    """Sends a camera's views to the fleet until it has no more, or until SIGTERM or Ctrl-C.

    Every setting can also be given as FLEETPOSE_ROBOT_<NAME> in the environment, or in a file.
    """
    parent = os.getppid()  # before the slow imports, in which the parent may end
    loaded = RobotSettings.load(settings, given)
    if dump_settings:
        typer.echo(loaded.as_toml(), nl=False)
        return

    from fleetpose.robot_agent import agent

    log_to_stderr()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    if end_with_parent:
        agent.end_with_parent(parent, stop)
    agent.run_agent(loaded, stop)
    _leave()


@app.command(
    "calibrate-check",
    epilog=examples("robot-agent calibrate-check --data /dev/video0 --calibration rig.yaml"),
)
def calibrate_check(
    data: Annotated[str, typer.Option(help="Folder, video, or device; or left,right.")],
    calibration: Calibration = None,
    translation_unit: Unit = None,
    size: Size = None,
    fps: Fps = None,
    fourcc: Fourcc = None,
    max_skew_ms: Skew = None,
    eyes: Eyes = "side-by-side",
    pairs: Annotated[int, typer.Option(min=1, help="So many pairs of images.")] = 10,
    interval: Annotated[float, typer.Option(min=0, help="Seconds between two of them.")] = 0.5,
    length: Annotated[float | None, typer.Option(help="A length you know, in metres.")] = None,
    board: Annotated[
        str | None,
        typer.Option(help="The side of a chessboard's squares; its inner corners, 9x6."),
    ] = None,
    points: Annotated[
        str | None, typer.Option(help="Between u1,v1,u2,v2 of the rectified left image.")
    ] = None,
    save: Annotated[
        Path | None, typer.Option(help="Write the rectified first pair with level lines (.png).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Says whether a stereo rig is as its calibration says, else what has moved and what to do.

    Ends with 0 where it fits, with 1 where it does not or cannot be told.
    """
    from fleetpose.robot_agent.cameras.stereo.video import video_settings
    from fleetpose.robot_agent.checking.command import CheckOptions, run

    log_to_stderr(logging.WARNING)
    video = video_settings(size, fps, fourcc, 10.0 if max_skew_ms is None else max_skew_ms, eyes)
    options = CheckOptions(
        *(data, calibration, video, pairs, interval, length, board, points, save, as_json),
        translation_unit,
    )
    raise typer.Exit(run(options))


@app.command(epilog=examples("robot-agent inspect recordings/kitchen"))
def inspect(
    source: Annotated[str, typer.Argument(help="Folder, file, or device; or left,right.")],
    calibration: Calibration = None,
    translation_unit: Unit = None,
    depth_scale: Annotated[
        float | None, typer.Option(help="Steps of depth images per metre.")
    ] = None,
    clouds: Annotated[str | None, typer.Option(help="Posed views: which kind of clouds.")] = None,
) -> None:
    """Says what a folder, a file or a device is, what is understood of it, and how to run it."""
    from fleetpose.robot_agent.checking import inspection

    logging.getLogger("fleetpose").propagate = False  # what readers warn of is printed as notes
    found = inspection.inspect(source, calibration, translation_unit, depth_scale, clouds)
    for line in found.lines(source):
        typer.echo(line)
    _leave()


@app.command(
    epilog=examples(
        "robot-agent topics walk.mcap",
        "robot-agent topics tcp/192.168.1.21:7447 --namespace /r1",
    )
)
def topics(
    source: Annotated[
        str, typer.Argument(help="A bag (.mcap, .db3, .bag, folder; or a,b), or tcp/ROBOT:7447.")
    ],
    namespace: Annotated[str, typer.Option(help="Of the robot's topics, e.g. /r1.")] = "",
    image: Annotated[str, typer.Option(help="The topic of colours.")] = "",
    depth: Annotated[str, typer.Option(help="The topic of depths.")] = "",
    left: Annotated[str, typer.Option(help="The topic of the left eye.")] = "",
    right: Annotated[str, typer.Option(help="The topic of the right eye.")] = "",
    cloud: Annotated[str, typer.Option(help="The topic of a cloud.")] = "",
    base: Annotated[str, typer.Option(help="The frame of the robot's body.")] = "base_link",
    up: Annotated[
        UpSource, typer.Option(help="What tells where up is: auto, odom, imu, tf, none.")
    ] = "auto",
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID of a robot.")] = 0,
    calibration: Calibration = None,
) -> None:
    """Says which topics of a bag, or of a robot with ROS 2, make a camera, and what is missing.

    Of each topic: its rate, and why it was chosen. A robot is listened to for two seconds.
    """
    from fleetpose.robot_agent.cameras.topics.options import TopicOptions
    from fleetpose.robot_agent.checking.topics.report import report

    logging.getLogger("fleetpose").propagate = False  # what readers warn of is printed as notes
    options = TopicOptions(namespace, image, depth, left, right, cloud, base, up=up)
    for line in report(source, options, calibration, domain):
        typer.echo(line)


def _leave() -> None:
    """Ends at once where a view is still being worked on or waited for, or the network is asked:
    the interpreter must not pull the rug from under OpenCV or zenoh, and nobody waits for it.
    """
    busy = ("sender ", "reader ", "silence")
    if any(thread.name.startswith(busy) for thread in threading.enumerate()):
        logging.shutdown()
        os._exit(0)


def main() -> None:
    """Runs the command line; what a user can mend is one sentence and exit code 2."""
    run_command(app, "robot-agent", "robot")


if __name__ == "__main__":
    main()
