"""`hmi-client tutor`: a hard session to learn on, and how far each point was off."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fleetpose.hmi_client.cli.options import Fps, KeysFile, OpenBrowser, Theme
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.protocol.commands import examples

app = typer.Typer()


@app.command(epilog=examples("hmi-client tutor", "hmi-client tutor site.mcap --web --apart r4"))
def tutor(
    file: Annotated[
        Path | None,
        typer.Argument(help="a recording of 'pose-server record'; default: the built-in lesson"),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="the page in place of the screen")] = False,
    listen: Annotated[
        str, typer.Option(help="with --web: HOST:PORT of the page; port 0: any")
    ] = "127.0.0.1:0",
    open_browser: OpenBrowser = True,
    apart: Annotated[
        str, typer.Option(help="robots that the machine may not join to the others: r4,r5")
    ] = "",
    speed: Annotated[
        float, typer.Option(help="of the recording, times as fast", min=0.05, max=100.0)
    ] = 1.0,
    report: Annotated[
        Path | None, typer.Option(help="a JSON file for all that was measured")
    ] = None,
    fps: Fps = 10.0,
    theme: Theme = "auto",
    keys: KeysFile = None,
) -> None:
    """Learn to click: join a fleet that is in pieces; then see how far each point was off.

    Without FILE a lesson is made: five robots before a facade of equal windows. Nothing of it
    reaches a real site: the robots' views go to a server of the lesson's own, on this machine, and
    so do your clicks. What it asks, advises and refuses is what a real one would. It ends when all
    robots are located, with q on the screen, or with Ctrl-C for the page. Then a table tells of
    each point how far it was off, whether the server took it, and what it did to the fleet.

    Offsets are exact in the lesson. In a recording they are against its final poses, which may be
    wrong themselves. What the machine joins by itself needs no click: --apart keeps robots from it.
    """
    if not web and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise OperatorError("the screen needs a terminal: run it in one, or give --web")
    from fleetpose.hmi_client.tutor.run import Face, run_tutor

    options = () if keys is None else ("--keys", str(keys))
    if web:
        shown = "--open" if open_browser else "--no-open"
        face = Face("web", ("--listen", listen, shown, *options))
    else:
        face = Face("screen", ("--fps", str(fps), "--theme", theme, *options))
    run_tutor(file, face, apart, speed, report)
