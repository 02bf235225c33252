"""`pose-server record` and `pose-server show`: a site in a file, and that file in other viewers."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import threading

    from fleetpose.pose_server.recording.site import Progress
    from fleetpose.protocol.transport import Link

app = typer.Typer()
DEFAULT_CONNECT = ["tcp/127.0.0.1:7447"]


@app.command()
def record(
    out: Annotated[Path, typer.Option(help="The recording, an MCAP file; it must not exist.")],
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="How long; if not told, until Ctrl-C.")
    ] = None,
    images: Annotated[
        bool,
        typer.Option(
            help="Robots send images only while somebody listens; over poor links do without."
        ),
    ] = True,
    connect: Annotated[
        list[str], typer.Option(help="Endpoint of the router, repeatable.")
    ] = DEFAULT_CONNECT,
    site: Annotated[str, typer.Option(help="Name of the site.")] = "demo",
    config: Annotated[
        Path | None, typer.Option(help="zenoh configuration (JSON5), replaces --connect.")
    ] = None,
    connect_timeout_s: Annotated[
        float, typer.Option(help="Wait so long for the router; negative: for ever.")
    ] = 10.0,
) -> None:
    """Keeps everything that a site says: views, images, odometry, clicks and receipts, poses, the
    fleet's state, tokens; each message as it was on the wire, at its time.

    It only listens. What is older than a second is in the file, also if this process is killed.
    Then `pose-eval replay FILE` aligns it all anew without a network, and `pose-server show FILE`
    makes a file for Foxglove or Rerun of it. Begin before the robots do: what was said before is
    not in it.

    Where a site has access rules, what they do not let this configuration hear is missing.
    """
    import signal
    import threading

    from fleetpose.pose_server.recording.site import SiteRecorder
    from fleetpose.protocol.keys import Keys

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    link = _link(connect, config, connect_timeout_s, stop)
    try:
        recorder = SiteRecorder(link, Keys(site), out, images)
        ended = recorder.run(stop, seconds, _say_progress)
    finally:
        link.close()
    print(f"{recorder.recorder.report()}: {ended}; {ended.cost}")


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="A recording of `pose-server record`.")],
    foxglove: Annotated[Path | None, typer.Option(help="MCAP file to write, for Foxglove.")] = None,
    rrd: Annotated[
        Path | None, typer.Option(help="File to write, for Rerun (extra `rerun`).")
    ] = None,
) -> None:
    """Makes a file for Foxglove or for Rerun of a recorded site: where the robots are and what they
    see, their images, and the links between them, coloured by verdict.

    The frames are `fleet`, `<robot>` (its body) and `<robot>/camera`; a robot that is not located
    has none. Clouds are thinned to 20 000 points. Open the file with `foxglove` or `rerun`.
    """
    from fleetpose.pose_server.recording.show import show as show_in
    from fleetpose.protocol.commands import require
    from fleetpose.protocol.recording.file import Recording, RecordingError

    if foxglove is None and rrd is None:
        raise RecordingError("say what to write: --foxglove FILE.mcap or --rrd FILE.rrd")
    require("record" + ",rerun" * (rrd is not None))  # else nothing is written at all
    recording = Recording(file)
    if recording.cut_off:
        print(f"{file} was cut off after {recording.seconds:.1f} s", file=sys.stderr)
    if foxglove is not None:
        from fleetpose.pose_server.recording.foxglove_file import FoxgloveFile

        print(f"{foxglove}: {show_in(recording, FoxgloveFile(foxglove))}")
    if rrd is not None:
        from fleetpose.pose_server.recording.rerun_file import RerunFile

        print(f"{rrd}: {show_in(recording, RerunFile(rrd))}")


def _link(
    connect: list[str], config: Path | None, timeout_s: float, stop: "threading.Event"
) -> "Link":
    from fleetpose.protocol.transport import Link, SessionSettings, open_session

    settings = SessionSettings(
        connect=tuple(connect), config_file=config, timeout_s=timeout_s, stop=stop
    )
    return Link(open_session(settings))


def _say_progress(progress: "Progress") -> None:
    """One line, over itself where that is a terminal; elsewhere nothing."""
    if sys.stderr.isatty():
        print(f"\r{progress}   ", end="", file=sys.stderr, flush=True)
