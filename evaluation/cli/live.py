"""Commands that run live processes."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fleetpose.evaluation.cli.options import (
    Clouds,
    MetresPerUnit,
    Mistakes,
    Out,
    Unique,
    World,
    numbers,
    only_one,
    refuse_offline,
)

app = typer.Typer()


@app.command()
def fleet(
    out: Out,
    robots: Annotated[
        int | None, typer.Option(min=2, help="How many. [default: 6; offline 4 to 12 by chance]")
    ] = None,
    seconds: Annotated[float, typer.Option(help="After all processes are up; more than 20.")] = 60,
    data: Annotated[
        list[Path] | None,
        typer.Option(help="Recording with ground truth; else the synthetic world. Offline: any."),
    ] = None,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    views: Annotated[
        str, typer.Option(help="A,B,C: one robot stands at each of these views of a recording.")
    ] = "",
    offline: Annotated[
        bool, typer.Option("--offline", help="Without network and clicks: many drawn fleets.")
    ] = False,
    seeds: Annotated[int, typer.Option(min=1, help="Offline: fleets of each recording.")] = 20,
    first: Annotated[int, typer.Option(help="Posed views: the first of consecutive views.")] = 0,
    skip_pairs: Annotated[
        Path | None, typer.Option(help="Lines 'r1 r2': pairs left to the operator.")
    ] = None,
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler that the server aligns on.")
    ] = None,
    clicks_per_minute: Annotated[float, typer.Option(min=0, help="Simulated operator.")] = 0.0,
    clicks_on_skipped: Annotated[
        int, typer.Option(min=0, help="The operator clicks so many points on each skipped pair.")
    ] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Alignment processes.")] = 2,
    moving: Annotated[bool, typer.Option("--moving", help="Synthetic robots walk.")] = False,
    world: World = None,
    unique: Unique = 0,
    seed: Annotated[int, typer.Option(help="Of the synthetic world and the operator.")] = 0,
    mistakes: Mistakes = 0.0,
    recipe: Annotated[
        Literal["full", "paper"],
        typer.Option(help="Of the server; paper: the method as published, which judges nothing."),
    ] = "full",
) -> None:
    """Run a live fleet on a recording or in the synthetic world and score its poses.

    With --offline: for each recording (--data, repeatable) and seed, robots at views drawn from
    anywhere on it, put together by the server's own jobs and solver in this machine's processes
    until nothing is left to align. Prints a line for each recording, the worst first, and every
    robot that is located and gravely off; writes summary.json and robots.csv.
    """
    from fleetpose.evaluation.data.reconstructed import all_in_metres

    sets = all_in_metres(data or (), metres_per_unit)
    kind = clouds.value if clouds else None
    named = tuple(numbers("--views", views)) if views else ()
    if offline:
        from fleetpose.evaluation.bench.offline import command

        refuse_offline(
            {
                "--recipe paper": recipe != "full",
                "--world": world is not None,
                "--clicks-per-minute": clicks_per_minute > 0,
                "--clicks-on-skipped": clicks_on_skipped > 0,
                "--skip-pairs": skip_pairs is not None,
                "--mistakes": mistakes > 0,
                "--cluster": cluster is not None,
                "--moving": moving,
            }
        )
        drawn = command.OfflineOptions(sets, kind, seeds, robots, named, workers)
        command.run(drawn, out)
        return
    from fleetpose.evaluation.system.fleet import FleetOptions, run

    options = FleetOptions(
        robots=robots or 6,
        seconds=seconds,
        data=only_one("--data", sets),
        clouds=kind,
        views=named,
        first=first,
        skip_pairs=skip_pairs,
        cluster=cluster,
        clicks_per_minute=clicks_per_minute,
        clicks_on_skipped=clicks_on_skipped,
        workers=workers,
        moving=moving,
        seed=seed,
        world=world.value if world else None,
        unique=unique,
        mistakes=mistakes,
        recipe=recipe,
    )
    run(options, out)


@app.command()
def restarts(
    out: Out,
    restarts: Annotated[int, typer.Option(min=1, help="How many fleets, one by one.")] = 30,
    robots: Annotated[int, typer.Option(min=2, help="In each.")] = 8,
    seconds: Annotated[float, typer.Option(min=1, help="From its start to its poses.")] = 12.0,
    data: Annotated[
        list[Path] | None,
        typer.Option(help="Recording; each fleet begins at another view of it. Repeatable."),
    ] = None,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    workers: Annotated[int, typer.Option(min=1, help="Alignment processes.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the first synthetic world; then one more.")] = 0,
    offline: Annotated[
        bool, typer.Option("--offline", help="Without network, by the server's jobs and solver.")
    ] = False,
) -> None:
    """Start fleets anew, each with other noise and other views, and compare the errors of their
    poses with the covariances that the server publishes.

    Of several recordings none is chosen: a line for each, the worst first. Recordings by a depth
    camera were tracked by that camera: they are judged against 0.05 m of noise in their own poses,
    and it is said.
    """
    from fleetpose.evaluation.data.reconstructed import all_in_metres
    from fleetpose.evaluation.system.restarts import RestartsOptions, run

    kind, sets = clouds.value if clouds else None, all_in_metres(data or (), metres_per_unit)
    run(RestartsOptions(restarts, robots, seconds, sets, kind, workers, seed, offline), out)


@app.command()
def faults(
    out: Out,
    kills: Annotated[
        int | None, typer.Option(min=0, help="Kill processes at random moments. [default: 20]")
    ] = None,
    freeze: Annotated[
        float | None, typer.Option(min=0, help="Freeze one client, seconds. [default: 10]")
    ] = None,
    late_clicks: Annotated[
        int | None, typer.Option(min=0, help="Click in images half a minute old. [default: 1000]")
    ] = None,
    inject: Annotated[
        str,
        typer.Option(
            help="Of none,skew,clock,baseline,mirrored,person,frozen,still,kidnapped,carried,"
            "carried-one,leave,old-epoch,clock-step; alone unless more is given."
        ),
    ] = "",
    seconds: Annotated[float, typer.Option(min=10, help="With each of these.")] = 50.0,
    robots: Annotated[int, typer.Option(min=3, max=16, help="With each of these.")] = 4,
    seed: Annotated[int, typer.Option(help="Which processes are killed, and when.")] = 0,
) -> None:
    """Kill server, router, robots and the operator's client under clicks, freeze a client, click
    late; count what is lost. Or spoil a robot's calibration, clock or trigger, have somebody walk
    through the scene, freeze a camera, carry robots away (--inject), and see whether it is named
    and does harm. 0: not this.
    """
    from fleetpose.evaluation.system.faults.command import FaultOptions, run

    usual = not inject
    options = FaultOptions(
        kills=20 * usual if kills is None else kills,
        freeze_s=10.0 * usual if freeze is None else freeze,
        late_clicks=1000 * usual if late_clicks is None else late_clicks,
        inject=tuple(inject.split(",")) if inject else (),
        inject_s=seconds,
        inject_robots=robots,
        seed=seed,
    )
    run(options, out)


@app.command(hidden=True)
def load(
    robot: Annotated[list[str], typer.Option(help="NAME,CAMERA,DATA; repeatable.")],
    connect: Annotated[list[str], typer.Option(help="Router; repeatable.")],
    site: Annotated[str, typer.Option(help="The fleet's site.")] = "demo",
    rate: Annotated[float, typer.Option(min=0.01, help="Views per second of each.")] = 1.0,
    frames: Annotated[int, typer.Option(min=1, help="Of each camera, shown in turn.")] = 1,
) -> None:
    """Replay views of several robots that were encoded beforehand."""
    from fleetpose.evaluation.simulate.replay_robots import Source, run

    run([Source.parse(text) for text in robot], tuple(connect), site, rate, frames)


@app.command()
def fuzz(
    out: Out,
    messages: Annotated[int, typer.Option(min=1, help="How many malformed messages.")] = 20_000,
    seed: Annotated[int, typer.Option(help="Which.")] = 0,
) -> None:
    """Send malformed, truncated, oversize and bomb payloads to every subscribed key of a fleet."""
    from fleetpose.evaluation.system.fuzz.command import passed, run

    raise typer.Exit(0 if passed(run(messages, out, seed)) else 1)


@app.command()
def demo(
    robots: Annotated[int, typer.Option(min=2, help="How many.")] = 6,
    seconds: Annotated[float, typer.Option(help="At most, without a screen.")] = 90,
    headless: Annotated[bool, typer.Option("--headless", help="Without a screen.")] = False,
) -> None:
    """Run a fleet in the synthetic world: on a terminal with the operator's screen."""
    from fleetpose.evaluation.system.demo import run, without_screen

    raise typer.Exit(run(robots, seconds, without_screen(headless)))


@app.command()
def world(
    listen: Annotated[str, typer.Option(help="Address, host:port.")] = "127.0.0.1:7500",
    robots: Annotated[int, typer.Option(min=1, help="How many.")] = 6,
    seed: Annotated[int, typer.Option(help="Of textures and noise.")] = 0,
    separation: Annotated[
        float | None, typer.Option(help="Degrees between neighbours; else at most 45, varying.")
    ] = None,
    moving: Annotated[bool, typer.Option("--moving", help="The robots walk slowly.")] = False,
    turning: Annotated[
        list[str] | None, typer.Option(help="A robot that looks to and fro; repeatable.")
    ] = None,
    person: Annotated[
        bool, typer.Option("--person", help="Somebody walks before the second robot.")
    ] = False,
    truth_file: Annotated[Path | None, typer.Option(help="Where true poses are written.")] = None,
    plan: World = None,
    unique: Unique = 0,
) -> None:
    """Serve a synthetic world, for robots with `--camera synthetic --data host:port/r1`."""
    from fleetpose.evaluation.simulate.world_server import WorldOptions
    from fleetpose.evaluation.simulate.world_server import main as serve

    options = WorldOptions(
        robots=robots,
        seed=seed,
        separation_deg=separation,
        moving=moving,
        turning=tuple(turning or ()),
        person=person,
        plan=plan.value if plan else None,
        unique=unique,
    )
    serve(options, listen, truth_file)
