"""The results of `pose-eval pairs`: CSV files, summary, plots, report, tables."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.pairs.calls import closest_calls
from fleetpose.evaluation.bench.pairs.html import write_html
from fleetpose.evaluation.bench.pairs.plots import plot_all
from fleetpose.evaluation.bench.pairs.row import PairRow, share_of, verified_nees
from fleetpose.evaluation.bench.pairs.words import binned, listed, named_shares
from fleetpose.evaluation.data.recording import Recording
from fleetpose.evaluation.data.splits import split_of
from fleetpose.evaluation.metrics.reliability import expected_calibration_error
from fleetpose.evaluation.metrics.scoring import (
    CHI2_6_95,
    Limits,
    percentile,
    share,
    trimmed_nees_per_dof,
)
from fleetpose.evaluation.report import output

ANGLE_BINS_DEG = ((0, 20), (20, 40), (40, 60), (60, 90), (90, 180))
SUCCESS_BINS = ((0.1, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5), (0.5, 1.0))
OVERLAP_BINS = ((0.0, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.5), (0.5, 1.0))
_POSE = (*output.POSE_COLUMNS, *output.COVARIANCE_COLUMNS)
POSE_FILE_COLUMNS = ("i", "j", "verdict", "align_ms", *_POSE, "p_grave")
TRUTH_COLUMNS = ("shared", "overlap", "angle_deg", "position_error_m", "rotation_error_deg")
EVIDENCE_FILE_COLUMNS = ("i", "j", "verdict", "ok", "grave", "start", *TRUTH_COLUMNS)
REMARK_COLUMNS = ("start", "wide", "inliers", "mirrored", "reasons")


def write_results(
    out: Path,
    recording: Recording,
    rows: Sequence[PairRow],
    median_depth_m: float,
    view_ms: Sequence[float],
) -> dict[str, Any]:
    """Writes poses.csv, pairs.csv, summary.json, the plots and report.html; prints the tables."""
    write_tables(out, rows)
    summary = {
        "split": split_of(recording.directory),
        **summarize(rows, median_depth_m, view_ms, recording.is_rgbd),
    }
    output.write_summary(out, summary)
    plots = plot_all(out, rows, median_depth_m)
    write_html(out / "report.html", recording, rows, summary, plots)
    _print(summary, recording.is_rgbd)
    return summary


def write_tables(out: Path, rows: Sequence[PairRow]) -> None:
    """Writes poses.csv, and pairs.csv with the truth and remarks beside it."""
    cells = [row.cells() for row in rows]
    output.write_csv(out / "poses.csv", POSE_FILE_COLUMNS, cells)
    output.write_csv(
        out / "pairs.csv", (*POSE_FILE_COLUMNS, *TRUTH_COLUMNS, *REMARK_COLUMNS), cells
    )
    names = sorted({name for row in rows for name in row.evidence})
    output.write_csv(
        out / "evidence.csv",
        (*EVIDENCE_FILE_COLUMNS, *names),
        [{**row.cells(), **row.evidence} for row in rows if row.evidence],
    )


def summarize(
    rows: Sequence[PairRow], median_depth_m: float, view_ms: Sequence[float], rgbd: bool
) -> dict[str, Any]:
    """The numbers of summary.json. Shares are of all pairs in question, answered or not."""
    nees = verified_nees(rows)
    below_60 = [row for row in rows if row.angle_deg < 60]
    verified = [row for row in rows if row.verdict == "verified"]
    return {
        "median_depth_m": median_depth_m,
        "view_ms": percentile(view_ms, 50),
        "align_ms_median": percentile([row.align_ms for row in rows], 50),
        "align_ms_settled": _median_ms(rows, wide=False),
        "align_ms_with_fallbacks": _median_ms(rows, wide=True),
        "pairs": len(rows),
        "ok": share(row.ok for row in rows),
        "ok_below_60": share(row.ok for row in below_60),
        "verified_ok": share(row.verdict == "verified" for row in rows if row.ok),
        "verified_ok_below_60": share(row.verdict == "verified" for row in below_60 if row.ok),
        "verified": len(verified),
        "grave_verified": sum(row.grave for row in verified),
        **_of_mirrored(rows),
        "expected_calibration_error": expected_calibration_error(
            [row.p_grave for row in rows if row.T_i_j is not None],
            [row.grave for row in rows if row.T_i_j is not None],
        ),
        "nees_per_dof": trimmed_nees_per_dof(nees),
        "coverage_95": share(value <= CHI2_6_95 for value in nees),
        "shares": _shares(rows),
        "success_overlap": _success_by_overlap(rows) if rgbd else None,
        "closest_calls": closest_calls(rows, Limits.of(median_depth_m, rgbd)),
        "verdicts": dict(Counter(row.verdict for row in rows)),
        "grave_by_verdict": dict(Counter(row.verdict for row in rows if row.grave)),
        "by_angle": [
            {"from_deg": low, "to_deg": high, **_recall(_within(rows, "angle_deg", low, high))}
            for low, high in ANGLE_BINS_DEG
        ],
        "by_overlap": [
            {"from": low, "to": high, **_recall(_within(rows, "overlap", low, high))}
            for low, high in OVERLAP_BINS
        ]
        if any(row.overlap is not None for row in rows)
        else None,
    }


def _of_mirrored(rows: Sequence[PairRow]) -> dict[str, int]:
    """Pairs of a camera that flips its images and one that does not; and of all, who was named."""
    mirrored = [row for row in rows if row.mirrored]
    return {
        "mirrored": len(mirrored),
        "mirrored_verified": sum(row.verdict == "verified" for row in mirrored),
        "mirrored_named": sum(row.named_mirrored for row in mirrored),
        "wrongly_named_mirrored": sum(row.named_mirrored for row in rows if not row.mirrored),
    }


def _median_ms(rows: Sequence[PairRow], wide: bool) -> float | None:
    """Of answered pairs that the usual salient points settled, or that went on to the wide ones."""
    some = [row.align_ms for row in rows if row.wide == wide and row.T_i_j is not None]
    return percentile(some, 50) if some else None


def _shares(rows: Sequence[PairRow]) -> dict[str, dict[str, Any]]:
    """The shares that count, of pairs with enough in common, with intervals."""
    near = [row for row in rows if row.enough_shared and row.angle_deg < 60]
    far = [row for row in rows if row.enough_shared and 60 <= row.angle_deg < 90]
    return {
        "ok_below_60": _interval(near, [row.ok for row in near]),
        "ok_60_90": _interval(far, [row.ok for row in far]),
        "verified_of_ok_below_60": _verified_of_ok(near),
        "verified_of_ok_60_90": _verified_of_ok(far),
    }


def _verified_of_ok(rows: Sequence[PairRow]) -> dict[str, Any]:
    right = [row for row in rows if row.ok]
    return _interval(right, [row.verdict == "verified" for row in right])


def _interval(rows: Sequence[PairRow], flags: Sequence[bool]) -> dict[str, Any]:
    return asdict(share_of(rows, flags))


def _success_by_overlap(rows: Sequence[PairRow]) -> list[dict[str, Any]]:
    """Share of pairs that are answered and not gravely wrong."""
    bins = []
    for low, high in SUCCESS_BINS:
        some = _within(rows, "overlap", low, high)
        success = [row.T_i_j is not None and not row.grave for row in some]
        bins.append({"from": low, "to": high, **_interval(some, success)})
    return bins


def _within(rows: Sequence[PairRow], field: str, low: float, high: float) -> list[PairRow]:
    last = high in (ANGLE_BINS_DEG[-1][1], OVERLAP_BINS[-1][1])
    values = [(getattr(row, field), row) for row in rows]
    return [
        row
        for value, row in values
        if value is not None and (low <= value < high or (last and value == high))
    ]


def _recall(rows: Sequence[PairRow]) -> dict[str, Any]:
    errors = [row.position_error_m for row in rows if row.position_error_m is not None]
    return {
        "pairs": len(rows),
        "ok": share(row.ok for row in rows),
        "not_grave": share(row.T_i_j is not None and not row.grave for row in rows),
        "verified": share(row.verdict == "verified" for row in rows),
        "grave_verified": sum(row.grave and row.verdict == "verified" for row in rows),
        "position_error_median_m": float(np.median(errors)) if errors else None,
        "align_ms_median": percentile([row.align_ms for row in rows], 50),
    }


def _print(summary: dict[str, Any], rgbd: bool) -> None:
    what = "overlap" if rgbd else "angle"
    output.print_table(f"pairs by {what}", *binned(what, summary[f"by_{what}"], rgbd))
    output.print_table("summary", ("", ""), listed(output.scalars(summary)))
    title = "shares, 95 % of bootstrap draws over views"
    output.print_table(title, *named_shares(summary["shares"]))
    if summary["success_overlap"]:
        title = "answered and not gravely wrong"
        output.print_table(title, *binned("overlap", summary["success_overlap"], True))
