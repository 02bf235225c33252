"""`pose-eval pairs`: every pair of a recording, automatically, against the truth.

Each view goes the whole way: stripped folder, the robot's camera, salient points, the bytes on the
wire, the server's preparation, the alignment.
"""

import itertools
import random
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.pairs.report import write_results
from fleetpose.evaluation.bench.pairs.row import PairRow
from fleetpose.evaluation.bench.pairs.worker import Answer, align, prepare_ms, true_overlap
from fleetpose.evaluation.bench.working import Bench, bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import Recording, TrueView, are_partners, shared_tracks
from fleetpose.evaluation.metrics.scoring import Limits, optical_angle_deg, pose_errors
from fleetpose.evaluation.options.recorded import PairsOptions
from fleetpose.evaluation.report.output import output_folder

TILE = 16  # pairs are done in squares of so many views, so that the caches serve


def run(options: PairsOptions, out: Path) -> dict[str, Any]:
    """Aligns all pairs; writes tables, plots and a report; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or the folder cannot be made.
    """
    recording = options.recording()
    pairs = limited(pairs_of(recording), options.limit)
    output_folder(out)
    median_m = median_depth_m(recording)
    with bench_of(options.workers) as bench:
        views = {view.index: view for pair in pairs for view in pair}
        flipped = mirrored_views(views, options.mirror_share)
        # two such cameras see one mirrored world, of which the recording's truth says nothing
        pairs = [(i, j) for i, j in pairs if not {i.index, j.index} <= flipped]
        wires, robot_ms = bench.on_the_wire(
            recording, views.values(), mirrored=flipped, images=options.images
        )
        server_ms = list(bench.pool.map(prepare_ms, wires.values()))
        limits = Limits.of(median_m, recording.is_rgbd)
        rows = []
        jobs = [(pair, (align, wires[pair[0].index], wires[pair[1].index])) for pair in pairs]
        for (i, j), answer in bench.as_done("pairs", jobs):
            row = scored(i, j, answer, limits)
            row.mirrored = (i.index in flipped) != (j.index in flipped)
            rows.append(row)
        _add_shared_or_overlap(recording, rows, bench)
    rows.sort(key=lambda row: (row.i, row.j))
    view_ms = [robot + server for robot, server in zip(robot_ms, server_ms, strict=True)]
    return write_results(out, recording, rows, median_m, view_ms)


def mirrored_views(views: Collection[int], share: float) -> frozenset[int]:
    """Which views' cameras flip their images: this share of them, by chance, always the same."""
    return frozenset(random.Random(0).sample(sorted(views), round(share * len(views))))


def pairs_of(recording: Recording) -> list[tuple[TrueView, TrueView]]:
    """All pairs i < j of views with clouds but stereo partners, in an order that suits caches."""
    pairs = [
        (i, j) for i, j in itertools.combinations(recording.usable, 2) if not are_partners(i, j)
    ]
    return sorted(
        pairs, key=lambda p: (p[0].index // TILE, p[1].index // TILE, p[0].index, p[1].index)
    )


def limited(
    pairs: list[tuple[TrueView, TrueView]], limit: int | None
) -> list[tuple[TrueView, TrueView]]:
    """At most `limit` of the pairs, spread evenly over the list."""
    if limit is None or limit >= len(pairs):
        return pairs
    chosen = np.linspace(0, len(pairs) - 1, max(limit, 1)).round().astype(int)
    return [pairs[k] for k in sorted(set(chosen.tolist()))]


def scored(i: TrueView, j: TrueView, answer: Answer, limits: Limits) -> PairRow:
    """An answer beside the truth."""
    errors = None if answer.T_i_j is None else pose_errors(i.T_to(j), answer.T_i_j)
    return PairRow(
        i=i.index,
        j=j.index,
        verdict=answer.verdict,
        align_ms=answer.align_ms,
        T_i_j=answer.T_i_j,
        covariance=answer.covariance,
        T_i_j_true=i.T_to(j),
        angle_deg=optical_angle_deg(i.T_world_camera, j.T_world_camera),
        position_error_m=errors and errors[0],
        rotation_error_deg=errors and errors[1],
        ok=errors is not None and limits.ok(*errors),
        grave=errors is not None and limits.grave(*errors),
        start=answer.start,
        inliers=answer.inliers,
        reasons="; ".join(answer.reasons),
        wide=answer.wide,
        p_grave=answer.p_grave,
        named_mirrored=answer.mirrored,
        evidence=answer.evidence,
    )


def _add_shared_or_overlap(recording: Recording, rows: list[PairRow], bench: Bench) -> None:
    """Posed views: track ids in common. Dense depth: overlap, which takes a while."""
    views = {view.index: view for view in recording.views}
    for row in rows:
        row.shared = shared_tracks(recording, views[row.i], views[row.j])
    if recording.is_rgbd or recording.clouds == "stereo_dense":
        jobs = [(row, (true_overlap, views[row.i], views[row.j], row.T_i_j_true)) for row in rows]
        for row, value in bench.as_done("overlap", jobs, in_flight=8):
            row.overlap = value
