"""Commands about pairs of views: how well they are aligned, and what clicks do for them."""

from pathlib import Path
from typing import Annotated

import typer

from fleetpose.evaluation.options.building import of
from fleetpose.evaluation.options.recorded import (
    AblateOptions,
    AlignOptions,
    ClicksOptions,
    ClusterOptions,
    Out,
    PairsOptions,
    PersistOptions,
    WireOptions,
)
from fleetpose.protocol.commands import examples

app = typer.Typer()


@app.command(epilog=examples("pose-eval pairs --data kitchen --limit 60 --out out/pairs"))
@of(PairsOptions)
def pairs(options: PairsOptions, out: Out) -> None:
    """Align every pair of a recording, automatically, and compare with the truth."""
    from fleetpose.evaluation.bench.pairs.command import run

    run(options, out)


@app.command(
    epilog=examples("pose-eval trust out/pairs out/other --held-out out/third --out out/trust")
)
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


@app.command(epilog=examples("pose-eval ablate --data kitchen --out out/ablate"))
@of(AblateOptions)
def ablate(
    options: AblateOptions,
    out: Out,
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Stages, GROUP, GROUP.NUMBER or GROUP.NUMBER=VALUE. [default: all]"),
    ] = None,
) -> None:
    """Switch a stage of the alignment off, or change a fitted number, and tell what that costs.

    Each number is tried with a fifth less and more: --by. What nothing defends can go.
    """
    from fleetpose.evaluation.bench.ablate import run

    run(options, names or [], out)


@app.command(epilog=examples("pose-eval cluster --data kitchen --out out/cluster"))
@of(ClusterOptions)
def cluster(options: ClusterOptions, out: Out) -> None:
    """Align pairs on Dask clusters of one, two, four workers on this machine: pairs per second,
    where more workers stop helping, and what one that dies costs.
    """
    from fleetpose.evaluation.bench.scale.cluster import run

    run(options, out)


@app.command(epilog=examples("pose-eval align --data kitchen --out out/align"))
@of(AlignOptions)
def align(options: AlignOptions, out: Out) -> None:
    """Align pairs that see enough of the same, beside Open3D and KISS-Matcher with GICP."""
    from fleetpose.evaluation.bench.align import run

    run(options, out)


@app.command(
    epilog=examples("pose-eval clicks --data kitchen --clicks 3 --angles 40,90 --out out/clicks")
)
@of(ClicksOptions)
def clicks(options: ClicksOptions, out: Out) -> None:
    """Click in all pairs of views within a range of angles, rightly or wrongly; tell how often the
    pose is right and the wrong clicks are named.

    Three clicks at wide angles: --clicks 3 --angles 40,90. One of five wrong: --clicks 5 --wrong 1;
    the summary then gives the success with the four right ones beside it.

    Clicks that deceive: --consistent-wrong 1.5 --clicks 3..6, or --permuted. These go through the
    server's own site, which knows two robots; the summary gives grave_located (robots that are
    located and gravely off: none is right), told_wrong, and recovered: three right clicks that are
    added afterwards win.
    """
    from fleetpose.evaluation.bench.clicks import command, deceived

    deceives = options.consistent_wrong_m or options.permuted
    (deceived if deceives else command).run(options, out)


@app.command(epilog=examples("pose-eval persist --data kitchen --out out/persist"))
@of(PersistOptions)
def persist(options: PersistOptions, out: Out) -> None:
    """Click once between two moving robots, then compare the next views with and without these
    clicks: the paper's last claim.

    With them, each alignment begins at the last pose, carried over by both robots' own motion, as
    the server does it. Without them each pair of views begins anew. The paper's ICP alone is
    measured beside both.
    """
    from fleetpose.evaluation.bench.persist.command import run

    run(options, out)


@app.command(epilog=examples("pose-eval wire --data kitchen --out out/wire"))
@of(WireOptions)
def wire(options: WireOptions, out: Out) -> None:
    """Measure the cloud codecs beside PNG, Draco and raw numbers."""
    from fleetpose.evaluation.bench.wire import run

    run(options, out)


@app.command(epilog=examples("pose-eval stereo --out out/stereo"))
def stereo(out: Out) -> None:
    """Play a stereo video of the synthetic world; check calibrations, right and wrong."""
    from fleetpose.evaluation.bench.stereo import run

    run(out)


@app.command(epilog=examples("pose-eval cameras --out out/cameras"))
def cameras(
    faults: Annotated[
        Path | None, typer.Option(help="Folder of cases, a folder each, that must not be misread.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of recordings, whose good rigs must not be blamed.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for attempts.csv and summary.json; it is made.")
    ] = None,
) -> None:
    """Read other people's cameras: files of calibrations in every tool's layout, folders as they
    are downloaded and as they are damaged, rigs good and bad, cameras that fail while they run.
    Each row tells its figure, its limit, and whether it is met; what failed is named with what was
    said of it. 0: all are met.

    Files and images are made here, with known numbers; --faults and --data add real ones.
    """
    from fleetpose.evaluation.bench.cameras.command import run

    raise typer.Exit(0 if run(faults, data, out) else 1)
