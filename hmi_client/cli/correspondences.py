"""`hmi-client correspondences ...`: the operator's clicks as commands.

Exit codes: 0 all accepted, 1 something was rejected, 3 not confirmed in time.
"""

import json
from pathlib import Path
from typing import Annotated

import typer

from fleetpose.hmi_client.cli import connection as c
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.protocol.commands import Group, examples

app = typer.Typer(cls=Group, help="Add, erase, list, export and import correspondences.")

Robot = Annotated[str, typer.Argument(help="a robot's name")]
Timeout = Annotated[float, typer.Option(help="seconds to wait for the server's receipt", min=0.0)]


@app.command(
    epilog=examples(
        "hmi-client correspondences add r1 r3 212,148,305,160",
        "hmi-client correspondences add r1 r3 212,148,305,160 90.5,77,181,80",
    )
)
def add(
    robot_1: Robot,
    robot_2: Robot,
    points: Annotated[
        list[str],
        typer.Argument(help="U1,V1,U2,V2: the pixel in the first image, then in the second"),
    ],
    view_i: Annotated[int | None, typer.Option(help="seq of the first robot's view")] = None,
    view_j: Annotated[int | None, typer.Option(help="seq of the second robot's view")] = None,
    timeout: Timeout = 5.0,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Adds correspondences; the views are the newest ones unless they are named."""
    from fleetpose.hmi_client.cli import clicking

    pixels = [clicking.four_numbers(point) for point in points]
    with c.Connection.of(connect, site, config, operator).server() as session:
        clicking.ordered(session, robot_1, robot_2)
        view_1 = clicking.newest(session, robot_1, view_i)
        view_2 = clicking.newest(session, robot_2, view_j)
        picks = [clicking.Pick.of(view_1, (a, b), view_2, (d, e)) for a, b, d, e in pixels]
        raise typer.Exit(clicking.add_all(session, picks, timeout))


@app.command(epilog=examples("hmi-client correspondences erase r1 r3 4 5"))
def erase(
    robot_1: Robot,
    robot_2: Robot,
    ids: Annotated[list[int], typer.Argument(help="ids, as 'list' shows them")],
    timeout: Timeout = 5.0,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Erases correspondences by their ids."""
    from fleetpose.hmi_client.cli import clicking

    with c.Connection.of(connect, site, config, operator).server() as session:
        pair = clicking.ordered(session, robot_1, robot_2)
        clicking.wait_for_sets(session)
        tickets = [session.erase(pair, id) for id in ids]
        clicking.finish(session, tickets, timeout)
        raise typer.Exit(clicking.report(session, tickets, [f"erased {id}" for id in ids]))


@app.command(epilog=examples("hmi-client correspondences clear r1 r3"))
def clear(
    robot_1: Robot,
    robot_2: Robot,
    timeout: Timeout = 5.0,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Erases all correspondences of a pair."""
    from fleetpose.hmi_client.cli import clicking

    with c.Connection.of(connect, site, config, operator).server() as session:
        pair = clicking.ordered(session, robot_1, robot_2)
        clicking.wait_for_sets(session)
        ticket = session.clear(pair)
        if ticket is None:
            typer.echo(f"{pair[0]} - {pair[1]} has no correspondences")
            return
        clicking.finish(session, [ticket], timeout)
        raise typer.Exit(clicking.report(session, [ticket], [f"cleared {pair[0]} - {pair[1]}"]))


@app.command("list", epilog=examples("hmi-client correspondences list r1 r3"))
def list_(
    robot_1: Annotated[str, typer.Argument(help="a robot's name; all pairs without")] = "",
    robot_2: Annotated[str, typer.Argument(help="the other robot")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="print JSON")] = False,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Lists the server's correspondences of one pair or of all."""
    from fleetpose.hmi_client.cli import clicking, correspondence_files
    from fleetpose.hmi_client.cli.reports import entries_text

    if bool(robot_1) != bool(robot_2):
        raise OperatorError("name two robots, or none for all pairs")
    with c.Connection.of(connect, site, config, operator).server() as session:
        pairs = [clicking.ordered(session, robot_1, robot_2)] if robot_1 else None
        clicking.wait_for_sets(session)
        for_pairs = pairs or clicking.pairs_with_any(session)
        records = [
            correspondence_files.record_of(pair, e)
            for pair in for_pairs
            for e in session.entries(pair)
        ]
        if as_json:
            typer.echo(json.dumps(records, indent=1))
            return
        for pair in for_pairs:
            entries = session.entries(pair)
            typer.echo(f"{pair[0]} - {pair[1]}: {len(entries)}")
            if entries:
                typer.echo(entries_text(pair, entries))
        if not for_pairs:
            typer.echo("no correspondences")


@app.command(epilog=examples("hmi-client correspondences export clicks.json"))
def export(
    file: Annotated[Path, typer.Argument(help="a .csv or .json file")],
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Writes all correspondences to a file that 'import' reads."""
    from fleetpose.hmi_client.cli import clicking, correspondence_files

    with c.Connection.of(connect, site, config, operator).server() as session:
        clicking.wait_for_sets(session)
        pairs = clicking.pairs_with_any(session)
        records = [
            correspondence_files.record_of(pair, e) for pair in pairs for e in session.entries(pair)
        ]
    correspondence_files.write_records(file, records)
    typer.echo(f"{len(records)} correspondences of {len(pairs)} pairs written to {file}")


@app.command("import", epilog=examples("hmi-client correspondences import clicks.json"))
def import_(
    file: Annotated[Path, typer.Argument(help="a .csv or .json file")],
    timeout: Timeout = 5.0,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Adds the correspondences of a file; those that are there already are left alone."""
    from fleetpose.hmi_client.cli import clicking, correspondence_files

    records = correspondence_files.read_records(file)
    with c.Connection.of(connect, site, config, operator).server() as session:
        clicking.wait_for_sets(session)
        picks = [
            correspondence_files.pick_of(r, session, f"{file}, record {k}")
            for k, r in enumerate(records, 1)
        ]
        fresh = [pick for pick in dict.fromkeys(picks) if session.find(pick) is None]
        if len(fresh) < len(picks):
            typer.echo(f"{len(picks) - len(fresh)} are there already")
        raise typer.Exit(clicking.add_all(session, fresh, timeout))
