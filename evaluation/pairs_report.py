"""The results of `pose-eval pairs`: CSV files, summary, tables, precision-recall plot."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.geometry import Floats
from evaluation.report import (
    COVARIANCE_COLUMNS,
    POSE_COLUMNS,
    new_figure,
    pose_cells,
    print_table,
    write_csv,
    write_summary,
)
from evaluation.scoring import percentile, precision_recall, share, weakest_sigma_m

VERDICTS = ("verified", "plausible", "ambiguous", "rejected")
ANGLE_BINS_DEG = ((0, 20), (20, 40), (40, 60), (60, 90), (90, 180))
OVERLAP_BINS = ((0.0, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.5), (0.5, 1.0))
POSE_FILE_COLUMNS = ("i", "j", "verdict", "align_ms", *POSE_COLUMNS, *COVARIANCE_COLUMNS)
TRUTH_COLUMNS = ("shared", "overlap", "angle_deg", "position_error_m", "rotation_error_deg")
REMARK_COLUMNS = ("start", "inliers", "reasons")


@dataclass
class PairRow:
    """One pair: what was answered and how right it is. `T_i_j` is camera j in camera i."""

    i: int
    j: int
    verdict: str
    align_ms: float
    T_i_j: Floats | None
    covariance: Floats | None
    T_i_j_true: Floats
    angle_deg: float
    position_error_m: float | None
    rotation_error_deg: float | None
    ok: bool
    grave: bool
    start: str
    inliers: int
    reasons: str
    shared: int | None = None
    overlap: float | None = None

    def cells(self) -> dict[str, Any]:
        """One row of the CSV files."""
        fields = {name: value for name, value in vars(self).items() if value is not None}
        return {**pose_cells(self.T_i_j, self.covariance), **fields}


def write_results(
    out: Path, rows: Sequence[PairRow], median_depth_m: float, view_ms: Sequence[float], rgbd: bool
) -> dict[str, Any]:
    """Writes poses.csv, pairs.csv, summary.json and the plot; prints the tables."""
    cells = [row.cells() for row in rows]
    write_csv(out / "poses.csv", POSE_FILE_COLUMNS, cells)
    write_csv(out / "pairs.csv", (*POSE_FILE_COLUMNS, *TRUTH_COLUMNS, *REMARK_COLUMNS), cells)
    summary = summarize(rows, median_depth_m, view_ms)
    write_summary(out, summary)
    plot_precision_recall(out / "precision_recall.png", rows)
    _print(summary, rgbd)
    return summary


def summarize(
    rows: Sequence[PairRow], median_depth_m: float, view_ms: Sequence[float]
) -> dict[str, Any]:
    """The numbers of summary.json. Shares are of all pairs in question, answered or not."""
    below_60 = [row for row in rows if row.angle_deg < 60]
    verified = [row for row in rows if row.verdict == "verified"]
    return {
        "median_depth_m": median_depth_m,
        "view_ms": percentile(view_ms, 50),
        "align_ms_median": percentile([row.align_ms for row in rows], 50),
        "pairs": len(rows),
        "ok": share(row.ok for row in rows),
        "ok_below_60": share(row.ok for row in below_60),
        "verified_ok": share(row.verdict == "verified" for row in rows if row.ok),
        "verified_ok_below_60": share(row.verdict == "verified" for row in below_60 if row.ok),
        "verified": len(verified),
        "grave_verified": sum(row.grave for row in verified),
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


def plot_precision_recall(path: Path, rows: Sequence[PairRow]) -> None:
    """Precision over recall, answers accepted by verdict, within a verdict by stated sigma."""
    answered = [row for row in rows if row.T_i_j is not None]
    ok = [row.ok for row in answered]
    rank = [float(len(VERDICTS) - VERDICTS.index(row.verdict)) for row in answered]
    sigmas = [weakest_sigma_m(row.covariance) for row in answered]
    by_sigma = [(r, -sigma) for r, sigma in zip(rank, sigmas, strict=True)]
    figure, axes = new_figure()
    if answered:
        axes.plot(*precision_recall(by_sigma, ok), label="by verdict, then stated sigma")
        recall, precision = precision_recall([(r,) for r in rank], ok)
        axes.plot(recall, precision, "o", label="verdicts")
        given = [v for v in VERDICTS if any(row.verdict == v for row in answered)]
        for name, x, y in zip(given, recall, precision, strict=True):
            axes.annotate(f" {name} or better", (x, y), fontsize=8, va="top", ha="right")
    axes.set(
        xlabel="recall: share of the right answers that are accepted",
        ylabel="precision: share of the accepted that are right",
        xlim=(0, 1.02),
        ylim=(0, 1.02),
        title=f"{len(rows)} pairs, {len(answered)} answered, {sum(ok)} right",
    )
    axes.grid(alpha=0.3)
    if answered:
        axes.legend(loc="lower left")
    figure.savefig(path)


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
    columns = (
        "pairs",
        "ok",
        "not_grave",
        "verified",
        "grave_verified",
        "position_error_median_m",
        "align_ms_median",
    )
    bins = summary["by_overlap"] if rgbd else summary["by_angle"]
    names = ("from", "to") if rgbd else ("from_deg", "to_deg")
    print_table(
        "pairs by overlap" if rgbd else "pairs by angle",
        ("", *columns),
        [(f"{b[names[0]]}-{b[names[1]]}", *(b[column] for column in columns)) for b in bins],
    )
    shown = [key for key, value in summary.items() if not isinstance(value, list | dict)]
    print_table("summary", ("", ""), [(key, summary[key]) for key in shown])
