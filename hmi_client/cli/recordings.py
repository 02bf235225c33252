"""`hmi-client record` and `hmi-client replay`: a session in a file, to train with and to test."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fleetpose.hmi_client.cli import connection as c
from fleetpose.hmi_client.cli.options import Fps, KeysFile, LogFile, Theme, Threshold
from fleetpose.protocol.commands import examples

app = typer.Typer()

File = Annotated[Path, typer.Argument(help="the recording, an MCAP file")]


@app.command(epilog=examples("hmi-client record shift.mcap"))
def record(
    file: File,
    fps: Fps = 10.0,
    threshold: Threshold = None,
    theme: Theme = "auto",
    keys: KeysFile = None,
    log: LogFile = None,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Shows the screen, and records all that comes and all you do in it.

    The file is MCAP: every message as it was on the wire, under its key, images included.
    """
    from fleetpose.hmi_client.tui.run import run_screen

    where = c.Connection.of(connect, site, config, operator)
    run_screen((where,), fps, threshold, log, theme, keys, record=file)


@app.command(epilog=examples("hmi-client replay shift.mcap --speed 4"))
def replay(
    file: File,
    speed: Annotated[float, typer.Option(help="times as fast", min=0.05, max=100.0)] = 1.0,
    start: Annotated[float, typer.Option(help="seconds from the beginning", min=0.0)] = 0.0,
    as_list: Annotated[
        bool, typer.Option("--list", help="print what was done, line by line; no screen")
    ] = False,
    fps: Fps = 10.0,
    threshold: Threshold = None,
    theme: Theme = "auto",
    keys: KeysFile = None,
    log: LogFile = None,
) -> None:
    """Plays a recorded session on the screen; needs no server.

    It follows what the operator looked at and did. You may look around; nothing can be changed.
    """
    if as_list or not (sys.stdin.isatty() and sys.stdout.isatty()):
        from fleetpose.hmi_client.recording.timeline import timeline
        from fleetpose.protocol.recording.file import Recording

        for line in timeline(Recording(file)):
            typer.echo(line)
        return
    from fleetpose.hmi_client.tui.replay import run_replay

    run_replay(file, speed, start, fps, threshold, log, theme, keys)
