"""`pose-server record` and `pose-server show`: a site in a file, and that file in other viewers."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fleetpose.protocol.commands import examples

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from fleetpose.pose_server.recording.site import Progress
    from fleetpose.protocol.recording.file import Recording
    from fleetpose.protocol.transport import Link

app = typer.Typer()
DEFAULT_CONNECT = ["tcp/127.0.0.1:7447"]


@app.command(epilog=examples("pose-server record --out walk.mcap --seconds 600"))
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

    Where a site has access rules, take a recorder's configuration (`pose-deploy add SITE recorder
    NAME`): nobody else but the server may hear everything.
    """
    from fleetpose.pose_server.recording.site import SiteRecorder
    from fleetpose.protocol.keys import Keys

    keys, stop = Keys(_site(site, config)), _stopped_by_signals()
    link = _link(connect, config, connect_timeout_s, stop)
    try:
        recorder = SiteRecorder(link, keys, out, images)
        ended = recorder.run(stop, seconds, _say_progress)
    finally:
        link.close()
    print(f"{recorder.recorder.report()}: {ended}; {ended.cost}")


@app.command(
    epilog=examples("pose-server show walk.mcap --rrd walk.rrd", "pose-server show --live")
)
def show(
    file: Annotated[
        Path | None,
        typer.Argument(help="A recording of `pose-server record`; with --live: or none."),
    ] = None,
    foxglove: Annotated[Path | None, typer.Option(help="MCAP file to write, for Foxglove.")] = None,
    rrd: Annotated[
        Path | None, typer.Option(help="File to write, for Rerun (extra `rerun`).")
    ] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="Serve Foxglove (extra `live`): the running site, or FILE at its own pace.",
        ),
    ] = False,
    listen: Annotated[
        str, typer.Option(help="With --live: where Foxglove connects to, host:port.")
    ] = "127.0.0.1:8765",
    connect: Annotated[
        list[str], typer.Option(help="With --live: endpoint of the router, repeatable.")
    ] = DEFAULT_CONNECT,
    site: Annotated[str, typer.Option(help="With --live: name of the site.")] = "demo",
    config: Annotated[
        Path | None, typer.Option(help="zenoh configuration (JSON5), replaces --connect.")
    ] = None,
    connect_timeout_s: Annotated[
        float, typer.Option(help="Wait so long for the router; negative: for ever.")
    ] = 10.0,
) -> None:
    """Shows a site in Foxglove or Rerun: where the robots are and what they see, their images, and
    the links between them, coloured by verdict. A recording becomes a file of theirs; with --live
    Foxglove connects to this process.

    The frames are `fleet`, `<robot>` (its body) and `<robot>/camera`; a robot that is not located
    has none. Clouds are thinned to 20 000 points. Open files with `foxglove` or `rerun`.

    --live only hears, and asks robots for no image that nobody looks at. Everybody who reaches its
    address sees the site: keep it on this machine, and reach it by `ssh -L 8765:127.0.0.1:8765`.
    """
    from fleetpose.protocol.commands import require
    from fleetpose.protocol.recording.file import RecordingError

    if live:
        require("record,live")
        site = _site(site, config)
        _show_live(file, listen, lambda stop: _link(connect, config, connect_timeout_s, stop), site)
        return
    if file is None or (foxglove is None and rrd is None):
        raise RecordingError(
            "say what to write: FILE --foxglove OUT.mcap or FILE --rrd OUT.rrd; or show it --live"
        )
    from fleetpose.pose_server.recording.show import show as show_in

    require("record" + ",rerun" * (rrd is not None))  # else nothing is written at all
    recording = _opened(file)
    if foxglove is not None:
        from fleetpose.pose_server.recording.foxglove_scene import FileSink, FoxgloveScene

        print(f"{foxglove}: {show_in(recording, FoxgloveScene(FileSink(foxglove)))}")
    if rrd is not None:
        from fleetpose.pose_server.recording.rerun_file import RerunFile

        print(f"{rrd}: {show_in(recording, RerunFile(rrd))}")


def _show_live(
    file: Path | None, listen: str, linked: "Callable[[threading.Event], Link]", site: str
) -> None:
    """Serves Foxglove until Ctrl-C."""
    from fleetpose.pose_server.recording.live import show_recording, show_site
    from fleetpose.protocol.keys import Keys
    from fleetpose.protocol.recording.file import RecordingError

    host, _, port = listen.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise RecordingError(f"--listen {listen}: write host:port, such as 127.0.0.1:8765")
    stop = _stopped_by_signals()

    def say(address: str) -> None:
        print(f"Foxglove: open connection, {address}; Ctrl-C ends it", flush=True)

    if file is not None:
        print(show_recording(_opened(file), host, int(port), stop, say))
        return
    link = linked(stop)
    try:
        print(show_site(link, Keys(site), host, int(port), stop, say))
    finally:
        link.close()


def _opened(file: Path) -> "Recording":
    from fleetpose.protocol.recording.file import Recording

    recording = Recording(file)
    if recording.cut_off:
        print(f"{file} was cut off after {recording.seconds:.1f} s", file=sys.stderr)
    return recording


def _stopped_by_signals() -> "threading.Event":
    """Set by Ctrl-C and by whoever ends this process."""
    import signal
    import threading

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop


def _site(told: str, config: Path | None) -> str:
    """The site that a configuration is for, else the one that was told.

    Raises:
        EndpointError: it belongs to a process that may not hear everything.
    """
    from fleetpose.protocol.session.identity import identity_in

    identity = None if config is None else identity_in(config, ("recorder", "server"))
    return told if identity is None else identity.site


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
