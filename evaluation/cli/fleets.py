"""Commands about whole fleets, without a network."""

from pathlib import Path
from typing import Annotated

import typer

from fleetpose.evaluation.options.building import of
from fleetpose.evaluation.options.fleets import NeighboursOptions, SynthOptions
from fleetpose.evaluation.options.published import BenchOptions, FormatsOptions
from fleetpose.evaluation.options.recorded import (
    MapOptions,
    Out,
    QuestionsOptions,
    RingOptions,
    SolveOptions,
)
from fleetpose.protocol.commands import examples

app = typer.Typer()


@app.command(epilog=examples("pose-eval ring --data kitchen --clicks 0,3 --draws 3 --out out/ring"))
@of(RingOptions)
def ring(options: RingOptions, out: Out) -> None:
    """Put robots on rings at 5 to 45 degrees, click on all neighbours, and locate them: the paper's
    Figs. 9 and 10.

    Every separation that the views allow is one ring: regular angles where the recording tells each
    view's place on its ring, every k-th view along the path elsewhere. Writes ring.csv, poses.csv,
    pairs.csv, summary.json, fig9.png and fig10.png; by the full recipe also fleet3d.png: the ring
    of the smallest separation in 3D, without clicks, like the paper's Fig. 8. A summary of the
    other recipe that is in the folder already is drawn beside this one. `--recipe both` leaves the
    tables in OUT/paper and OUT/full. Quick: --clicks 0,3 --draws 3.
    """
    from fleetpose.evaluation.bench.ring.command import run

    run(options, out)


@app.command("map", epilog=examples("pose-eval map --data kitchen --out out/map"))
@of(MapOptions)
def fleet_map(options: MapOptions, out: Out) -> None:
    """Put a fleet together without network and clicks, merge its map, and lay it beside the truth:
    how far poses move points, how far the map is from the true cloud and the true cloud from the
    map, and how far noise alone would bring it, with the poses true.

    Writes map.ply, map.png and summary.json.
    """
    from fleetpose.evaluation.bench.mapping.command import run

    run(options, out)


@app.command(
    epilog=examples(
        "pose-eval bench --layout euroc --data euroc --robots MH_01_easy,MH_02_easy \\",
        "    --out out/euroc",
    )
)
@of(BenchOptions)
def bench(options: BenchOptions, out: Out) -> None:
    """Play a published benchmark by its sequences as robots, without network and clicks, and print
    the absolute trajectory error beside what papers report.

    The error is counted twice: after one rigid fit of all robots together, and after one for each.
    Estimates are those of all views at the end. Writes summary.json and the trajectories (tum/). As
    unpacked: euroc DATA/MH_01_easy/mav0; kitti DATA/sequences/00 with DATA/poses/00.txt; tum
    DATA/SEQUENCE/rgb.txt; 7scenes DATA/seq-01/frame-*.pose.txt; replica DATA/SEQUENCE/results; of
    bags s3e, kimera-multi and graco, with NAME_gt.txt beside them. One sequence for three robots:
    --robots 00 --split 3. One street alone: --layout kitti without --robots.
    """
    from fleetpose.evaluation.bench.published.command import run

    run(options, out)


@app.command(epilog=examples("pose-eval formats --out out/formats"))
@of(FormatsOptions)
def formats(options: FormatsOptions, out: Out) -> None:
    """Write trajectories and reconstructions of a small fleet; compare what others make of them:
    evo's ATE of the TUM files and pycolmap's reprojection of the COLMAP files must be ours to 1e-6
    (--python, of an environment that has both; they are no part of this one). COLMAP, Bundler and
    NVM files are read back, and Bundler's own example (--bundle) must fit to 0.21 px.

    Prints each bar with its figure and its limit, writes the files and summary.json, and ends with
    1 where a bar is not met. What was not given to compare with is told as not checked.
    """
    from fleetpose.evaluation.bench.formats.command import run

    raise typer.Exit(run(options, out))


@app.command(epilog=examples("pose-eval neighbours --robots 200 --out out/neighbours"))
@of(NeighboursOptions)
def neighbours(options: NeighboursOptions, out: Out) -> None:
    """Ask the server's index of keyframes for the neighbours of each of a thousand robots, in as
    many synthetic towns as they fill: how many it finds, and how long that takes beside comparing
    all with all.

    Writes neighbours.csv and summary.json. Making a thousand views takes ten minutes on two cores.
    """
    from fleetpose.evaluation.bench.scale.neighbours import run

    run(options, out)


@app.command(epilog=examples("pose-eval synth --robots 24 --out out/town"))
@of(SynthOptions)
def synth(options: SynthOptions, out: Out) -> None:
    """Write a synthetic world as a folder of posed views: the town square with robots on a ring at
    360/N degrees, or with --world a place of alike parts with robots here and there.

    Then run it: `pose-eval ring --data OUT --clouds stereo_dense --out RESULTS`; a plan:
    `pose-eval pairs --data OUT --clouds stereo_dense --out RESULTS`.
    """
    from fleetpose.evaluation.bench.synth import run

    run(options, out)


@app.command(epilog=examples("pose-eval solve --robots 72 --out out/solve"))
@of(SolveOptions)
def solve(options: SolveOptions, out: Out) -> None:
    """Solve a fleet's pose graph, without cameras or a network: how fast, and does it find the
    wrong edges.

    Half of the edges are there at first, the others come one by one. Robots are joined by a tree
    of right edges; wrong ones are as sure of themselves as the right ones.
    """
    from fleetpose.evaluation.bench import solve as solving

    if options.g2o is not None:
        solving.run_recorded(options.g2o, out)
    else:
        solving.run(options, out)


@app.command(epilog=examples("pose-eval questions --data kitchen --seeds 5 --out out/questions"))
@of(QuestionsOptions)
def questions(options: QuestionsOptions, out: Out) -> None:
    """Count clicks until the whole fleet is located and right: by the server's questions, by the
    paper's rule (the largest error of the matrix first), by chance, and at least.

    Each seed draws 8 to 12 views as robots that fall into several parts after all pairs were
    aligned automatically, or that are joined wrongly. A simulated operator clicks three points per
    question, 1.5 px off; two images with too little in common cost two clicks. With --mistakes some
    questions are answered by the next window, one step along, left for right, or by one such point
    among right ones. Writes runs.csv, summary.json and clicks.png.
    """
    from fleetpose.evaluation.bench.questions.command import run

    run(options, out)


@app.command(epilog=examples("pose-eval replay walk.mcap --out out/replay"))
def replay(
    file: Annotated[Path, typer.Argument(help="A recording of 'pose-server record'.")],
    out: Out,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Alignments at once; if not told, as recorded.")
    ] = None,
    job_ms: Annotated[
        float | None,
        typer.Option(
            min=1.0, help="How long one takes by the recording's clock; else as recorded."
        ),
    ] = None,
) -> None:
    """Drive what a recorded site's server had heard, in order of arrival, through the server's own
    pipeline: in one process, without a network, by the recording's clock. Two replays give the same
    bytes, so that a recording is a bug report that anybody can run.

    Jobs take as long as the recorded server's did, whatever they take here. Says how far the poses
    are from those in the recording. Writes poses.csv, a TUM trajectory for each robot and
    summary.json. Wide keypoints, which a server asks robots for, are in no recording.
    """
    from fleetpose.evaluation.bench.replay.command import run, sentence

    print(sentence(run(file, out, workers, job_ms)))
