"""`pose-eval`: measures everything against ground truth."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fleetpose.evaluation.cli import live
from fleetpose.evaluation.cli.options import (
    Clouds,
    Data,
    MetresPerUnit,
    Mistakes,
    Out,
    Unique,
    World,
    only_one,
)
from fleetpose.evaluation.cli.options import numbers as _numbers
from fleetpose.protocol.commands import Version, require, run_command

app = typer.Typer(no_args_is_help=True, add_completion=False, rich_markup_mode=None)
app.add_typer(live.app)


class RecipeOption(StrEnum):
    """Ways to align a pair."""

    paper = "paper"
    full = "full"
    both = "both"


@app.callback()
def _commands(version: Version = False) -> None:
    """Measure the system against ground truth."""
    if "--help" not in sys.argv:  # what a command does can be read without
        require("eval")


@app.command()
def pairs(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    limit: Annotated[int | None, typer.Option(min=1, help="So many pairs, spread evenly.")] = None,
    mirror_share: Annotated[
        float, typer.Option(min=0, max=1, help="Share of the cameras that flip their images.")
    ] = 0.0,
    images: Annotated[
        bool, typer.Option("--images/--without-images", help="Robots have images, or clouds alone.")
    ] = True,
) -> None:
    """Align every pair of a recording, automatically, and compare with the truth."""
    from fleetpose.evaluation.bench.pairs.command import run
    from fleetpose.evaluation.data.reconstructed import in_metres

    data = in_metres(data, metres_per_unit)
    run(data, clouds.value if clouds else None, out, workers, limit, mirror_share, images)


@app.command()
def trust(
    fitted: Annotated[list[Path], typer.Argument(help="Folders that `pairs` wrote, to fit on.")],
    out: Out,
    held_out: Annotated[
        list[Path] | None, typer.Option(help="Folders that `pairs` wrote, to judge on.")
    ] = None,
) -> None:
    """Fit the probability of a grave error to some places, and judge it on others."""
    from fleetpose.evaluation.bench.trust import run

    run(fitted, held_out or [], out)


@app.command()
def align(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    workers: Annotated[
        int, typer.Option(min=1, help="Pairs at a time; more than one spoils the times.")
    ] = 1,
    limit: Annotated[int | None, typer.Option(min=1, help="So many pairs, spread evenly.")] = None,
    min_overlap: Annotated[
        float, typer.Option(min=0, max=1, help="RGB-D: pairs that overlap less are left out.")
    ] = 0.3,
) -> None:
    """Align pairs that see enough of the same, beside Open3D and KISS-Matcher with GICP."""
    from fleetpose.evaluation.bench.align import run
    from fleetpose.evaluation.data.reconstructed import in_metres

    data = in_metres(data, metres_per_unit)
    run(data, clouds.value if clouds else None, out, workers, limit, min_overlap)


@app.command()
def ring(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    recipe: Annotated[
        RecipeOption,
        typer.Option(help="paper: its method alone; full: the server's; both: side by side."),
    ] = RecipeOption.full,
    wrong_clicks: Annotated[
        float, typer.Option(min=0, max=1, help="Share of the clicks that are 50 px off.")
    ] = 0.0,
    draws: Annotated[int, typer.Option(min=1, help="Of clicks, per pair.")] = 20,
    clicks: Annotated[str, typer.Option(help="Numbers of clicks per pair.")] = "0,1,2,3,4,5",
    starts: Annotated[
        int, typer.Option(min=1, help="Rings per separation, at most, each begun elsewhere.")
    ] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the clicks.")] = 0,
) -> None:
    """Put robots on rings at 5 to 45 degrees, click on all neighbours, and locate them: the paper's
    Figs. 9 and 10.

    Every separation that the views allow is one ring: regular angles where the recording tells each
    view's place on its ring, every k-th view along the path elsewhere. Writes ring.csv, poses.csv,
    pairs.csv, summary.json, fig9.png and fig10.png; by the full recipe also fleet3d.png: the ring
    of the smallest separation in 3D, without clicks, like the paper's Fig. 8. A summary of the
    other recipe that is in the folder already is drawn beside this one. `--recipe both` leaves the
    tables in OUT/paper and OUT/full. Quick: --clicks 0,3 --draws 3.
    """
    from fleetpose.evaluation.bench.ring.command import RingOptions, run
    from fleetpose.evaluation.data.reconstructed import in_metres

    options = RingOptions(
        data=in_metres(data, metres_per_unit),
        clouds=clouds.value if clouds else None,
        recipe=recipe.value,
        clicks=tuple(_numbers("--clicks", clicks)),
        wrong_share=wrong_clicks,
        draws=draws,
        starts=starts,
        workers=workers,
        seed=seed,
    )
    run(options, out)


@app.command("map")
def fleet_map(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    robots: Annotated[int, typer.Option(min=2, help="On consecutive views.")] = 8,
    first: Annotated[int, typer.Option(min=0, help="Posed views: the first of them.")] = 0,
    voxel_m: Annotated[
        float | None,
        typer.Option(help="Edge of the map's voxels, metres. [default: what suits the cameras]"),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes that make the views.")] = 2,
) -> None:
    """Put a fleet together without network and clicks, merge its map, and lay it beside the truth:
    how far poses move points, how far the map is from the true cloud and the true cloud from the
    map, and how far noise alone would bring it, with the poses true.

    Writes map.ply, map.png and summary.json.
    """
    from fleetpose.evaluation.bench.mapping.command import MapOptions, run

    kind = clouds.value if clouds else None
    run(MapOptions(data, kind, robots, first, voxel_m, workers), out)


@app.command()
def clicks(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    clicks: Annotated[
        str, typer.Option(help="Per pair; with --consistent-wrong also from..to, e.g. 3..6.")
    ] = "3",
    wrong: Annotated[int, typer.Option(min=0, help="So many of them are 50 px off.")] = 0,
    consistent_wrong: Annotated[
        float,
        typer.Option(min=0, metavar="METRES", help="All are so far along the surface off instead."),
    ] = 0.0,
    permuted: Annotated[
        bool, typer.Option("--permuted", help="Click four points of a plane in every wrong order.")
    ] = False,
    automatic: Annotated[
        bool,
        typer.Option("--automatic", help="With these two: the server aligns the pair first."),
    ] = False,
    angles: Annotated[str, typer.Option(help="Between optical axes, degrees.")] = "40,90",
    min_shared: Annotated[int, typer.Option(min=0, help="Points that both views see.")] = 30,
    draws: Annotated[int, typer.Option(min=1, help="Of clicks, per pair.")] = 20,
    limit: Annotated[int | None, typer.Option(min=1, help="So many pairs, spread evenly.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the clicks.")] = 0,
) -> None:
    """Click in all pairs of views within a range of angles, rightly or wrongly; tell how often the
    pose is right and the wrong clicks are named.

    Three clicks at wide angles: --clicks 3 --angles 40,90. One of five wrong: --clicks 5 --wrong 1;
    the summary then gives the success with the four right ones beside it.

    Clicks that deceive: --consistent-wrong 1.5 --clicks 3..6, or --permuted. These go through the
    server's own site, which knows two robots; the summary gives grave_located (robots that are
    located and gravely off: none is right), told_wrong, and recovered: three right clicks that are
    added afterwards win.
    """
    from fleetpose.evaluation.bench.clicks import command as clicking
    from fleetpose.evaluation.bench.clicks import deceived
    from fleetpose.evaluation.data.reconstructed import in_metres

    low, high = _numbers("--angles", angles, 2)
    fewest, most = _from_to("--clicks", clicks)
    if fewest < most and not consistent_wrong:
        raise typer.BadParameter(f"--clicks {clicks}: from..to goes with --consistent-wrong")
    options = clicking.ClicksOptions(
        data=in_metres(data, metres_per_unit),
        clouds=clouds.value if clouds else None,
        clicks=fewest,
        wrong=wrong,
        angles_deg=(low, high),
        min_shared=min_shared,
        draws=draws,
        limit=limit,
        workers=workers,
        seed=seed,
        consistent_wrong_m=consistent_wrong,
        most_clicks=most,
        permuted=permuted,
        automatic=automatic,
    )
    deceives = options.consistent_wrong_m or options.permuted
    (deceived if deceives else clicking).run(options, out)


@app.command()
def synth(
    out: Out,
    robots: Annotated[
        int, typer.Option(min=2, help="On the ring 8 to 72: neighbours are 360/N deg apart.")
    ],
    seed: Annotated[int, typer.Option(help="Of textures, places and noise.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    world: World = None,
    unique: Unique = 0,
) -> None:
    """Write a synthetic world as a folder of posed views: the town square with robots on a ring at
    360/N degrees, or with --world a place of alike parts with robots here and there.

    Then run it: `pose-eval ring --data OUT --clouds stereo_dense --out RESULTS`; a plan:
    `pose-eval pairs --data OUT --clouds stereo_dense --out RESULTS`.
    """
    from fleetpose.evaluation.bench.synth import SynthOptions, run

    run(out, SynthOptions(robots, seed, world.value if world else None, unique), workers)


@app.command()
def persist(
    out: Out,
    data: Annotated[
        Path | None, typer.Option(help="RGB-D folder with ground truth; else the synthetic world.")
    ] = None,
    views: Annotated[int, typer.Option(min=1, help="Followed after the clicks.")] = 20,
    clicks: Annotated[int, typer.Option(min=3, help="In the first views of a run.")] = 3,
    runs: Annotated[int, typer.Option(min=1, help="At most, begun at different views.")] = 10,
    separation: Annotated[
        float, typer.Option(min=1, max=180, help="Of the robots in the synthetic world, degrees.")
    ] = 45.0,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(help="Of clicks and of the world.")] = 0,
) -> None:
    """Click once between two moving robots, then compare the next views with and without these
    clicks: the paper's last claim.

    With them, each alignment begins at the last pose, carried over by both robots' own motion, as
    the server does it. Without them each pair of views begins anew. The paper's ICP alone is
    measured beside both.
    """
    from fleetpose.evaluation.bench.persist.command import PersistOptions, run

    run(PersistOptions(data, views, clicks, runs, separation, workers, seed), out)


@app.command()
def solve(
    out: Out,
    robots: Annotated[int, typer.Option(min=2, help="How many.")] = 72,
    edges: Annotated[int, typer.Option(min=1, help="Alignments between them.")] = 400,
    wrong: Annotated[float, typer.Option(min=0, max=0.9, help="Share that is wrong.")] = 0.3,
    seed: Annotated[int, typer.Option(help="Of the fleet.")] = 0,
    g2o: Annotated[
        Path | None, typer.Option(help="A recorded pose graph instead: a file, or a folder.")
    ] = None,
) -> None:
    """Solve a fleet's pose graph, without cameras or a network: how fast, and does it find the
    wrong edges.

    Half of the edges are there at first, the others come one by one. Robots are joined by a tree
    of right edges; wrong ones are as sure of themselves as the right ones.
    """
    from fleetpose.evaluation.bench import solve as solving

    if g2o is not None:
        solving.run_recorded(g2o, out)
    else:
        solving.run(robots, edges, wrong, out, seed)


@app.command()
def questions(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    seeds: Annotated[int, typer.Option(min=1, help="Fleets, each drawn by a seed.")] = 20,
    first: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    mistakes: Mistakes = 0.0,
) -> None:
    """Count clicks until the whole fleet is located and right: by the server's questions, by the
    paper's rule (the largest error of the matrix first), by chance, and at least.

    Each seed draws 8 to 12 views as robots that fall into several parts after all pairs were
    aligned automatically, or that are joined wrongly. A simulated operator clicks three points per
    question, 1.5 px off; two images with too little in common cost two clicks. With --mistakes some
    questions are answered by the next window, one step along, left for right, or by one such point
    among right ones. Writes runs.csv, summary.json and clicks.png.
    """
    from fleetpose.evaluation.bench.questions.command import QuestionsOptions, run
    from fleetpose.evaluation.data.reconstructed import in_metres

    kind = clouds.value if clouds else None
    data = in_metres(data, metres_per_unit)
    options = QuestionsOptions(data, kind, seeds, first, workers, mistakes)
    run(options, out)


@app.command()
def hmi(
    out: Out,
    robots: Annotated[int, typer.Option(min=2, help="Robots in the fleet.")] = 72,
    seconds: Annotated[float, typer.Option(min=5, help="Of the measurement of costs.")] = 60.0,
    moving: Annotated[bool, typer.Option("--moving", help="Cameras that pan.")] = False,
    targets: Annotated[int, typer.Option(min=1, help="To pick, by keys and by mouse.")] = 50,
    size: Annotated[str, typer.Option(help="Columns x rows of the terminal.")] = "160x50",
) -> None:
    """Measure the text client in a pseudo-terminal (bytes, CPU, memory, from key to screen), with
    poses and errors of a fleet at 10 Hz and two images at 5 Hz; then pick targets by keys and by
    mouse in a real terminal (tmux).
    """
    from fleetpose.evaluation.system.terminal.hmi import HmiOptions, run
    from fleetpose.hmi_client.cli.commands import size_of

    run(HmiOptions(robots, seconds, moving, targets, *size_of(size)), out)


@app.command("stand-in", hidden=True)
def stand_in(
    notes: Annotated[Path, typer.Option(help="File for the operator's updates.")],
    robots: Annotated[int, typer.Option(min=2)] = 72,
    moving: Annotated[bool, typer.Option("--moving")] = False,
    connect: Annotated[list[str] | None, typer.Option(help="Endpoint of the router.")] = None,
    site: Annotated[str, typer.Option(help="Name of the site.")] = "demo",
) -> None:
    """Say what a server and robots would say, for `hmi`."""
    from fleetpose.evaluation.system.terminal.stand_in import Load, run

    run(Load(robots, moving=moving), tuple(connect or ()), site, notes)


@app.command()
def operate(
    out: Out,
    data: Annotated[
        Path | None, typer.Option(help="Recording; default: the synthetic world.")
    ] = None,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    robots: Annotated[int, typer.Option(min=2, help="The last one is kept apart.")] = 3,
    first: Annotated[int, typer.Option(min=0, help="The first view.")] = 0,
    points: Annotated[int, typer.Option(min=1, help="Points to click.")] = 3,
    by_hand: Annotated[bool, typer.Option(help="Without the server's suggestions.")] = False,
    kill_server: Annotated[
        bool, typer.Option(help="Kill it (SIGKILL) in the middle of the second click, by hand.")
    ] = False,
    size: Annotated[str, typer.Option(help="Columns x rows of the terminal.")] = "160x50",
    theme: Annotated[str, typer.Option(help="Of the screen: auto, dark, light, mono.")] = "auto",
) -> None:
    """Join a fleet in two pieces by keys alone: the text client in a real terminal (tmux), and a
    simulated person who sees what is on it. Writes every screen and summary.json.
    """
    from fleetpose.evaluation.data.reconstructed import all_in_metres
    from fleetpose.evaluation.system.terminal.operate import OperateOptions, run
    from fleetpose.hmi_client.cli.commands import size_of

    kind = clouds.value if clouds else None
    how = (by_hand, kill_server, *size_of(size))
    data = only_one("--data", all_in_metres([data] if data else [], metres_per_unit))
    run(OperateOptions(data, kind, robots, first, points, *how, theme), out)


@app.command()
def stereo(out: Out) -> None:
    """Play a stereo video of the synthetic world; check calibrations, right and wrong."""
    from fleetpose.evaluation.bench.stereo import run

    run(out)


@app.command()
def wire(
    data: Data,
    out: Out,
    clouds: Clouds = None,
    metres_per_unit: MetresPerUnit = None,
    views: Annotated[int, typer.Option(min=1, help="So many, spread evenly.")] = 10,
) -> None:
    """Measure the cloud codecs beside PNG, Draco and raw numbers."""
    from fleetpose.evaluation.bench.wire import run
    from fleetpose.evaluation.data.reconstructed import in_metres

    data = in_metres(data, metres_per_unit)
    run(data, clouds.value if clouds else None, out, views)


def _from_to(option: str, text: str) -> tuple[int, int]:
    """One whole number, or two with dots between them.

    Raises:
        FleetPoseError: it is something else.
    """
    first, dots, last = text.partition("..")
    (low,) = _numbers(option, first, 1)
    (high,) = _numbers(option, last, 1) if dots else (low,)
    if not 0 <= low <= high:
        from fleetpose.protocol.errors import FleetPoseError

        raise FleetPoseError(f"{option} {text!r}: write a number like 3, or from..to like 3..6")
    return low, high


def main() -> None:
    """Runs the command line; what a user can mend is one sentence and exit code 2."""
    run_command(app, "pose-eval", "eval")


if __name__ == "__main__":
    main()
