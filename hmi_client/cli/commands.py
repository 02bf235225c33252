"""The command `hmi-client`: screen, screenshot, record, replay, watch, status, why and
correspondences.
"""

import json
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated

import typer

from fleetpose.hmi_client.cli import connection as c
from fleetpose.hmi_client.cli import correspondences, recordings, tutor, web
from fleetpose.hmi_client.cli.options import Fps, KeysFile, LogFile, SettingsFile, Theme, Threshold
from fleetpose.hmi_client.errors import NoServerError, OperatorError
from fleetpose.hmi_client.settings import ClientSettings
from fleetpose.protocol.commands import Version, command_line, examples
from fleetpose.protocol.settings import DumpSettings

LATCHED_S = 1.0  # what is latched and has not come by then was never told

app = command_line(no_args_is_help=False)
app.add_typer(correspondences.app, name="correspondences")
app.add_typer(recordings.app)
app.add_typer(tutor.app)
app.add_typer(web.app)


@app.callback(
    invoke_without_command=True,
    epilog=examples(
        "hmi-client --connect tcp/192.168.1.10:7447",
        "hmi-client --site hall,yard",
        "hmi-client why r3",
    ),
)
def default(
    context: typer.Context,
    fps: Fps = 10.0,
    threshold: Threshold = None,
    theme: Theme = "auto",
    keys_file: KeysFile = None,
    log: LogFile = None,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Sites = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
    settings: SettingsFile = None,
    dump_settings: DumpSettings = False,
    version: Version = False,
) -> None:
    """The operator's client of a fleet: see where every robot is, and help where asked.

    Without a command it is the screen. Options count for the command behind them as well. Those
    that a settings file may hold can also be given as FLEETPOSE_HMI_<NAME> in the environment.
    """
    if dump_settings:
        given = context.params | {"keys": keys_file}
        in_use = {name: given[name] for name in ClientSettings.model_fields}
        typer.echo(ClientSettings.model_validate(in_use).as_toml(), nl=False)
        raise typer.Exit
    if context.invoked_subcommand is not None:
        return
    if sys.stdin.isatty() and sys.stdout.isatty():
        screen(fps, threshold, theme, keys_file, log, connect, site, config, operator)
    else:
        typer.echo(context.get_help())


@app.command(epilog=examples("hmi-client screen --connect tcp/192.168.1.10:7447 --site hall"))
def screen(
    fps: Fps = 10.0,
    threshold: Threshold = None,
    theme: Theme = "auto",
    keys_file: KeysFile = None,
    log: LogFile = None,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Sites = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Shows map, errors and images, of one site at a time; q quits, b goes to the next one."""
    from fleetpose.hmi_client.tui.run import run_screen

    where = c.Connection.each(connect, site, config, operator)
    run_screen(where, fps, threshold, log, theme, keys_file)


@app.command(epilog=examples("hmi-client screenshot --out fleet.svg --size 160x50"))
def screenshot(
    out: Annotated[Path, typer.Option(help="the SVG file")],
    size: Annotated[str, typer.Option(help="columns x rows")] = "160x50",
    after: Annotated[float, typer.Option(help="seconds to wait at most", min=0.0)] = 10.0,
    pair: Annotated[str, typer.Option(help="R1,R2 [default: the first question's]")] = "",
    maximise: Annotated[bool, typer.Option(help="show the images only")] = False,
    theme: Theme = "auto",
    threshold: Threshold = None,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Draws the screen into an SVG as soon as poses and images are there."""
    from fleetpose.hmi_client.tui.drawing import palette
    from fleetpose.hmi_client.tui.run import take_screenshot

    columns, rows = size_of(size)
    where = c.Connection.of(connect, site, config, operator)
    palette.use(palette.theme_for(theme))
    complete = take_screenshot(where, out, (columns, rows), after, pair, maximise, threshold)
    missing = "" if complete else f" (after {after:.0f} s not everything had arrived)"
    typer.echo(f"{out}{missing}")


@app.command("keys", epilog=examples("hmi-client keys > my-keys.toml"))
def show_keys(keys_file: KeysFile = None) -> None:
    """Prints the keys of all commands, as a file that you can change and use (--keys)."""
    from fleetpose.hmi_client.local_files import keymap_of

    typer.echo(keymap_of(keys_file).as_toml(), nl=False)


@app.command(epilog=examples("hmi-client watch", "hmi-client watch --json --seconds 60"))
def watch(
    seconds: Annotated[
        float | None, typer.Option(help="stop after so many [default: at Ctrl-C]")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON lines")] = False,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="for router and server; else exit code 3")
    ] = True,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Sites = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Prints poses, errors of pairs and events as they change."""
    from fleetpose.hmi_client.cli.reports import watching

    sites = c.Connection.each(connect, site, config, operator)
    with suppress(KeyboardInterrupt), ExitStack() as opened:
        if len(sites) == 1:
            sessions = [opened.enter_context(sites[0].server(patient=wait))]
        else:
            sessions = opened.enter_context(c.servers(sites, patient=wait))
        end = None if seconds is None else time.monotonic() + seconds
        for line in watching(
            {w.site: s for w, s in zip(sites, sessions, strict=True)}, as_json, end
        ):
            typer.echo(line)


@app.command(epilog=examples("hmi-client status --connect tcp/192.168.1.10:7447"))
def status(
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Sites = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Prints the server's load, the robots and what is asked; exit code 3 without a server."""
    sites, absent = c.Connection.each(connect, site, config, operator), []
    for where in sites:
        if len(sites) > 1:
            typer.echo(f"{'' if where is sites[0] else chr(10)}site {where.site}")
        try:
            typer.echo(_status_of(where))
        except NoServerError as error:
            absent.append(error)
            if len(sites) > 1:
                typer.echo(str(error))
    if absent:
        raise absent[0]


def _status_of(where: c.Connection) -> str:
    from fleetpose.hmi_client.cli.reports import status_text, terminal_columns
    from fleetpose.protocol.transport import wait_until

    with where.server() as session:
        session.wait_change({}, ("status",), 2.0)
        wait_until(lambda: set(session.robots()) <= set(session.versions), LATCHED_S, poll_s=0.1)
        return status_text(session, terminal_columns())


@app.command(epilog=examples("hmi-client why r3"))
def why(
    robot: Annotated[str, typer.Argument(help="a robot's name")],
    as_json: Annotated[bool, typer.Option("--json", help="print JSON")] = False,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Says why a robot is located (exit code 0) or not (1), and what to do next."""
    from fleetpose.hmi_client.cli.clicking import wait_for_sets
    from fleetpose.hmi_client.cli.reports import terminal_columns
    from fleetpose.hmi_client.cli.why import tried_pairs, why_record, why_text
    from fleetpose.protocol.transport import wait_until

    with c.Connection.of(connect, site, config, operator).client_of_server() as client:
        session = client.session
        session.robot(robot)
        wait_for_sets(session)
        tried = set(tried_pairs(session, robot))
        wait_until(lambda: tried <= set(session.alignments(robot)), LATCHED_S, poll_s=0.1)
        record = why_record(session, robot, session.alignments(robot))
    typer.echo(json.dumps(record, indent=1) if as_json else why_text(record, terminal_columns()))
    raise typer.Exit(0 if record["located"] else 1)


def size_of(text: str) -> tuple[int, int]:
    """Parses COLUMNSxROWS.

    Raises:
        OperatorError: it is none, or too small to show anything.
    """
    try:
        columns, rows = (int(number) for number in text.lower().split("x"))
    except ValueError:
        columns, rows = 0, 0
    if not (40 <= columns <= 500 and 15 <= rows <= 200):
        raise OperatorError(f"'{text}' is no size: write e.g. 160x50 (40x15 to 500x200)")
    return columns, rows
