"""Commands that run live processes."""

from pathlib import Path
from typing import Annotated

import typer

from fleetpose.evaluation.options.bags import BagsOptions
from fleetpose.evaluation.options.building import of
from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.options.fleets import (
    FaultOptions,
    FleetOptions,
    HmiOptions,
    OperateOptions,
    RestartsOptions,
    SoakOptions,
    WorldOptions,
)
from fleetpose.evaluation.options.recorded import Out
from fleetpose.evaluation.options.ros import RosOptions
from fleetpose.evaluation.options.web import WebOptions
from fleetpose.protocol.commands import examples

app = typer.Typer()


@app.command(
    epilog=examples(
        "pose-eval fleet --robots 6 --seconds 60 --out out/fleet",
        "pose-eval fleet --offline --data kitchen --seeds 5 --out out/offline",
    )
)
@of(FleetOptions)
def fleet(options: FleetOptions, out: Out) -> None:
    """Run a live fleet on a recording or in the synthetic world and score its poses.

    With --offline: for each recording (--data, repeatable) and seed, robots at views drawn from
    anywhere on it, put together by the server's own jobs and solver in this machine's processes
    until nothing is left to align. Prints a line for each recording, the worst first, and every
    robot that is located and gravely off; writes summary.json and robots.csv.
    """
    if options.offline:
        from fleetpose.evaluation.bench.offline import command

        options.refuse_offline()
        command.run(options, out)
        return
    from fleetpose.evaluation.system.fleet import run

    run(options, out)


@app.command(epilog=examples("pose-eval restarts --out out/restarts"))
@of(RestartsOptions)
def restarts(options: RestartsOptions, out: Out) -> None:
    """Start fleets anew, each with other noise and other views, and compare the errors of their
    poses with the covariances that the server publishes.

    Of several recordings none is chosen: a line for each, the worst first. Recordings by a depth
    camera were tracked by that camera: they are judged against 0.05 m of noise in their own poses,
    and it is said.
    """
    from fleetpose.evaluation.system.restarts import run

    run(options, out)


@app.command(epilog=examples("pose-eval soak --hours 1 --out out/soak"))
@of(SoakOptions)
def soak(options: SoakOptions, out: Out) -> None:
    """Let a fleet of walking robots run for hours under an operator who clicks, while processes are
    killed and frozen one after the other. Tells what was lost or doubled, who was gravely located,
    how long views waited for poses, and how fast each process grows.

    Writes seconds.csv, troubles.csv, soak.png and summary.json.
    """
    from fleetpose.evaluation.system.soak.command import run

    run(options, out)


@app.command(epilog=examples("pose-eval faults --kills 10 --out out/faults"))
@of(FaultOptions)
def faults(options: FaultOptions, out: Out) -> None:
    """Kill server, router, robots and the operator's client under clicks, freeze a client, click
    late; count what is lost. Or spoil a robot's calibration, clock or trigger, have somebody walk
    through the scene, freeze a camera, carry robots away (--inject), and see whether it is named
    and does harm. 0: not this.
    """
    from fleetpose.evaluation.system.faults.command import run

    run(options.with_usual(), out)


@app.command(epilog=examples("pose-eval field --attacks --out out/field"))
@of(FieldOptions)
def field(options: FieldOptions, out: Out) -> None:
    """Run a small fleet from a site's bundles (TLS on both sides, rules that deny by default) and
    measure what an attack, a broken link or a change of certificates and rules does to it. Each
    part that is asked for has a site of its own; summary.json has its figures under its name.

    --attacks: how many attacks passed, and the share that the router named by certificate and key.
    --silent: of ten causes, how many the agent and `pose-deploy check` name. --rotate, --kills: how
    long receipts of clicks stayed away, and what was lost or doubled. --radio: how many robots are
    located behind a poor radio link, how old their poses are and how long clicks wait, with reno
    and with bbr; it skips, with a word, where there is no TUN or no network namespace.
    """
    from fleetpose.evaluation.system.field.command import run

    run(options, out)


@app.command(epilog=examples("pose-eval bags --out out/bags"))
@of(BagsOptions)
def bags(options: BagsOptions, out: Out) -> None:
    """Hold robots out of bags to their bars, without ROS: `robot-agent topics` ends 0 on every bag;
    a scene in every form in which bags come is read as it was, none of its frames lost, raw ones
    within 10 ms; two live robots on recorded bags are both verified, where they truly were, with
    no clock blamed and no pose stale; and so are two of which one plays a bag of ROS 1.

    Recorded bags tell their truth in ground_truth/pose; robots get bags without it. Without --data
    they walk through the synthetic town. Prints each bar with its figure and its limit, writes
    summary.json, and ends with 1 where one is not met.
    """
    from fleetpose.evaluation.bench.bags.command import run

    raise typer.Exit(run(options, out))


@app.command(epilog=examples("pose-eval ros --out out/ros"))
@of(RosOptions)
def ros(options: RosOptions, out: Out) -> None:
    """Run stand-ins for robots that run ROS 2 (rmw_zenoh as of Jazzy and of Humble, and behind
    zenoh-bridge-ros2dds) with raw depth images at 30 Hz, real agents and a server; then each
    robot's frames alone. Prints whether the bars are met: time to the first pose, megabytes a
    second and the share of a core that an agent takes, and how far off the robots are. Ends
    with 1 where one is not.
    """
    from fleetpose.evaluation.system.ros.command import passed, run

    raise typer.Exit(0 if passed(run(options, out)) else 1)


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


@app.command(epilog=examples("pose-eval fuzz --messages 2000 --out out/fuzz"))
def fuzz(
    out: Out,
    messages: Annotated[int, typer.Option(min=0, help="How many malformed messages.")] = 20_000,
    files: Annotated[int, typer.Option(min=0, help="How many damaged files.")] = 0,
    seed: Annotated[int, typer.Option(help="Which.")] = 0,
    ros: Annotated[bool, typer.Option("--ros", help="Damaged input of ROS instead.")] = False,
    count: Annotated[int, typer.Option(min=1, help="With --ros: how many pieces.")] = 20_000,
) -> None:
    """Send malformed, truncated, oversize and bomb payloads to every subscribed key of a fleet.

    --files damages calibrations of every tool and lists of recordings, without a network: each must
    be read or refused, within a second; their summary is in OUT/files. --messages 0: these alone.

    --ros damages messages, tokens, attachments and bags of ROS instead: none may come out as
    another error than ours, take more than a second, or not be counted.
    """
    if ros:
        from fleetpose.evaluation.system.fuzz import ros as of_ros

        raise typer.Exit(0 if of_ros.passed(of_ros.run(count, out, seed)) else 1)
    from fleetpose.evaluation.system.fuzz import command
    from fleetpose.evaluation.system.fuzz import files as of_files

    good = True
    if files:
        good = of_files.passed(of_files.run(files, out / "files", seed))
    if messages or not files:
        good = command.passed(command.run(messages, out, seed)) and good
    raise typer.Exit(0 if good else 1)


@app.command(epilog=examples("pose-eval demo", "pose-eval demo --robots 4 --web"))
def demo(
    robots: Annotated[int, typer.Option(min=2, help="How many.")] = 6,
    seconds: Annotated[float, typer.Option(help="At most, without a screen.")] = 90,
    headless: Annotated[bool, typer.Option("--headless", help="Without a screen.")] = False,
    web: Annotated[bool, typer.Option("--web", help="The page in a browser, no screen.")] = False,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for pictures of screen and map; no screen then.")
    ] = None,
) -> None:
    """Run a fleet in the synthetic world: on a terminal with the operator's screen."""
    from fleetpose.evaluation.system.demo import run, without_screen

    alone = pictures is not None or (not web and without_screen(headless))
    face = "none" if alone else "web" if web else "text"
    raise typer.Exit(run(robots, seconds, face, pictures))


@app.command(hidden=True)
def tutor(
    keep: Annotated[Path, typer.Option(help="Where the built-in lesson is kept.")],
    recording: Annotated[Path | None, typer.Option(help="Of a site; else the lesson.")] = None,
    apart: Annotated[str, typer.Option(help="Robots that the machine may not join: a,b")] = "",
    speed: Annotated[float, typer.Option(min=0.05, max=100.0, help="Times as fast.")] = 1.0,
) -> None:
    """Run a recording as a live fleet for `hmi-client tutor`, and say what was done to it."""
    from fleetpose.evaluation.system.tutor.command import run

    run(recording, keep, tuple(filter(None, apart.split(","))), speed)


@app.command(epilog=examples("pose-eval world --listen 127.0.0.1:7500"))
@of(WorldOptions)
def world(
    options: WorldOptions,
    listen: Annotated[str, typer.Option(help="Address, host:port.")] = "127.0.0.1:7500",
    truth_file: Annotated[Path | None, typer.Option(help="Where true poses are written.")] = None,
) -> None:
    """Serve a synthetic world, for robots with `--camera synthetic --data host:port/r1`."""
    from fleetpose.evaluation.simulate.world_server import main as serve

    serve(options, listen, truth_file)


@app.command(epilog=examples("pose-eval hmi --out out/hmi"))
@of(HmiOptions)
def hmi(options: HmiOptions, out: Out) -> None:
    """Measure the text client in a pseudo-terminal (bytes, CPU, memory, from key to screen), with
    poses and errors of a fleet at 10 Hz and two images at 5 Hz; then pick targets by keys and by
    mouse in a real terminal (tmux).
    """
    from fleetpose.evaluation.system.terminal.hmi import run

    run(options, out)


@app.command(epilog=examples("pose-eval web --bars 1,3 --out out/web"))
@of(WebOptions)
def web(options: WebOptions, out: Out) -> None:
    """Hold the operator's page to its bars: `hmi-client web` in Chromium without a screen, before a
    stand-in for server and robots that tells poses and errors of the whole fleet at 10 Hz and two
    images at 5 Hz.

    Prints each bar with its figure and its limit; writes summary.json, report.md and screenshots.
    Ends with 1 where one is not met, with 2 where there is no browser, and says what to install.
    """
    from fleetpose.evaluation.system.web.command import run_web

    raise typer.Exit(run_web(options, out))


@app.command("stand-in", hidden=True)
def stand_in(
    notes: Annotated[Path, typer.Option(help="File for the operator's updates.")],
    robots: Annotated[int, typer.Option(min=2)] = 72,
    moving: Annotated[bool, typer.Option("--moving")] = False,
    rate: Annotated[float, typer.Option(help="Poses per second.", min=0.1)] = 10.0,
    image_rate: Annotated[float, typer.Option(help="Images per second.", min=0.1)] = 5.0,
    points: Annotated[int, typer.Option(help="Points of a pair that is held.", min=0)] = 0,
    questions: Annotated[int, typer.Option(help="That are asked.", min=0, max=2)] = 2,
    connect: Annotated[list[str] | None, typer.Option(help="Endpoint of the router.")] = None,
    site: Annotated[str, typer.Option(help="Name of the site.")] = "demo",
) -> None:
    """Say what a server and robots would say, for `hmi` and `web`."""
    from fleetpose.evaluation.system.terminal.stand_in import Load, run

    load = Load(robots, rate, image_rate, moving, points, questions)
    run(load, tuple(connect or ()), site, notes)


@app.command(epilog=examples("pose-eval operate --out out/operate"))
@of(OperateOptions)
def operate(options: OperateOptions, out: Out) -> None:
    """Join a fleet in two pieces by keys alone: the text client in a real terminal (tmux), and a
    simulated person who sees what is on it. Writes every screen and summary.json.
    """
    from fleetpose.evaluation.system.terminal.operate import run

    run(options, out)
