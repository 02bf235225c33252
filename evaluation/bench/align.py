"""`pose-eval align`: pair alignment beside the usual pipelines, on the same pairs in one run.

All methods get the bytes that the robots sent. Each pair is given to one method after the other, so
that whatever else the machine does meets all of them.
"""

import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.align_worker import Timed, align_ours, align_peers, missing_peers
from fleetpose.evaluation.bench.baselines import PEERS, VOXEL_M
from fleetpose.evaluation.bench.pairs.command import limited, pairs_of
from fleetpose.evaluation.bench.pairs.worker import true_overlap, use_one_thread
from fleetpose.evaluation.bench.working import Bench
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import Recording, TrueView, shared_tracks
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import Limits, percentile, pose_errors, share
from fleetpose.evaluation.options.recorded import AlignOptions
from fleetpose.evaluation.report import output
from fleetpose.protocol.errors import DataFolderError

OURS = "fleetpose"
MIN_SHARED = 30
RECALL_M, RECALL_DEG = 0.3, 15.0
STRICT_M, STRICT_DEG = 0.05, 2.0
VOXEL_PER_DEPTH = 0.025  # 5 cm in a room
COLUMNS = ("method", "pairs", "recall", "strict_recall", "pair_ms_median", "whole_ms_median")


@dataclass(frozen=True)
class Bars:
    """What counts as found: errors below these, metres and degrees."""

    recall_m: float
    recall_deg: float
    strict_m: float
    strict_deg: float

    @classmethod
    def of(cls, median_depth_m: float, rgbd: bool) -> "Bars":
        """RGB-D: 0.3 m and 15 deg, strictly 5 cm and 2 deg; posed views: not grave, strictly ok."""
        if rgbd:
            return cls(RECALL_M, RECALL_DEG, STRICT_M, STRICT_DEG)
        limits = Limits.of(median_depth_m, rgbd)
        return cls(limits.grave_m, limits.grave_deg, limits.ok_m, limits.ok_deg)


def run(options: AlignOptions, out: Path) -> dict[str, Any]:
    """Aligns pairs by every method that can be loaded; writes align.csv and summary.json; returns
    the summary.

    Raises:
        FleetPoseError: the data cannot be used, or the folder not made.
    """
    workers, recording = options.workers, options.recording()
    output.output_folder(out)
    median_m = median_depth_m(recording)
    voxel_m = VOXEL_M if recording.is_rgbd else VOXEL_PER_DEPTH * median_m
    with (
        tempfile.TemporaryDirectory(prefix="fleetpose-") as folder,
        ProcessPoolExecutor(workers, get_context("spawn"), use_one_thread) as ours,
        # Peers may use all cores, as they do out of the box.
        ProcessPoolExecutor(workers, get_context("spawn")) as theirs,
        output.progress_bar() as progress,
    ):
        bench = Bench(ours, workers, Path(folder), progress)
        pairs = limited(_alignable(recording, options.min_overlap, bench), options.limit)
        views = {view.index: view for pair in pairs for view in pair}
        wires, robot_ms = bench.on_the_wire(recording, views.values(), images=options.images)
        robot_ms_of = dict(zip(views, robot_ms, strict=True))
        missing = theirs.submit(missing_peers).result()
        for name, reason in missing.items():
            progress.console.print(f"without {name}: {reason}")
        able = [peer for peer in PEERS if options.images or not peer.needs_images]
        peers = [peer.name for peer in able if peer.name not in missing]
        task = progress.add_task("pairs", total=len(pairs))

        def by_all(pair: tuple[TrueView, TrueView]) -> dict[str, Timed]:
            i, j = (view.index for view in pair)
            own = ours.submit(align_ours, wires[i], wires[j]).result()
            whole_ms = own.whole_ms + robot_ms_of[i] + robot_ms_of[j]
            rest = theirs.submit(align_peers, wires[i], wires[j], VOXEL_M / voxel_m, peers).result()
            progress.advance(task)
            return {OURS: replace(own, whole_ms=whole_ms), **rest}

        with ThreadPoolExecutor(workers) as at_once:
            answers = list(at_once.map(by_all, pairs))
    bars = Bars.of(median_m, recording.is_rgbd)
    truths = [i.T_to(j) for i, j in pairs]
    rows = [
        score(name, truths, [answer[name] for answer in answers], bars) for name in (OURS, *peers)
    ]
    output.write_csv(out / "align.csv", COLUMNS, rows)
    rgbd = recording.is_rgbd
    least = {"min_overlap": options.min_overlap} if rgbd else {"min_shared": MIN_SHARED}
    summary = {
        "median_depth_m": median_m,
        "pairs": len(pairs),
        "images": options.images,
        **least,
        **asdict(bars),
        "voxel_m": voxel_m,
        "workers": workers,
        "load_average": os.getloadavg()[0],  # well above the workers: others share the cores
        "methods": {row["method"]: row for row in rows},
        # At the scale where a voxel is 5 cm.
        "settings": {peer.name: peer.settings for peer in able},
        "missing": missing,
    }
    output.write_summary(out, summary)
    _print(summary)
    return summary


def score(
    method: str, truths: Sequence[Floats], answers: Sequence[Timed], bars: Bars
) -> dict[str, Any]:
    """A method's shares of all pairs, answered or not, and its median times."""
    errors = [
        (float("inf"), float("inf")) if answer.T_i_j is None else pose_errors(truth, answer.T_i_j)
        for truth, answer in zip(truths, answers, strict=True)
    ]
    return {
        "method": method,
        "pairs": len(errors),
        "recall": share(m < bars.recall_m and deg < bars.recall_deg for m, deg in errors),
        "strict_recall": share(m < bars.strict_m and deg < bars.strict_deg for m, deg in errors),
        "pair_ms_median": percentile([answer.pair_ms for answer in answers], 50),
        "whole_ms_median": percentile([answer.whole_ms for answer in answers], 50),
        "pair_cpu_ms_median": percentile([answer.pair_cpu_ms for answer in answers], 50),
    }


def _alignable(
    recording: Recording, min_overlap: float, bench: Bench
) -> list[tuple[TrueView, TrueView]]:
    """The pairs that see enough of the same: by overlap (RGB-D), or by shared tracks."""
    pairs = pairs_of(recording)
    if recording.is_rgbd:
        jobs = [(n, (true_overlap, i, j, i.T_to(j))) for n, (i, j) in enumerate(pairs)]
        overlaps = dict(bench.as_done("overlap", jobs, in_flight=8))
        chosen = [pair for n, pair in enumerate(pairs) if overlaps[n] >= min_overlap]
    else:
        chosen = [p for p in pairs if (shared_tracks(recording, *p) or 0) >= MIN_SHARED]
    if not chosen:
        raise DataFolderError(f"no pair of {recording.directory} sees enough of the same")
    return chosen


def _print(summary: dict[str, Any]) -> None:
    output.print_table(
        f"pairs with at least {summary['min_overlap']:g} overlap"
        if "min_overlap" in summary
        else f"pairs with at least {summary['min_shared']} shared tracks",
        ("method", "pairs", "recall", "strict", "pair ms", "whole ms", "pair cpu ms"),
        [
            [row[column] for column in (*COLUMNS, "pair_cpu_ms_median")]
            for row in summary["methods"].values()
        ],
    )
    print(
        "recall: below {recall_m:.3g} m and {recall_deg:g} deg; "
        "strict: below {strict_m:.3g} m and {strict_deg:g} deg".format_map(summary)
    )
    print(f"peers at a voxel of {summary['voxel_m']:.3g} m; with the scene scaled to 5 cm a voxel:")
    for name, settings in summary["settings"].items():
        print(f"  {name}: {settings}")
