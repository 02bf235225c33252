"""The plots of `pose-eval pairs`, each a PNG file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.pairs.row import VERDICTS, PairRow, verified_nees
from fleetpose.evaluation.metrics.intervals import share_over_views
from fleetpose.evaluation.metrics.reliability import plot_reliability
from fleetpose.evaluation.metrics.scoring import precision_recall, weakest_sigma_m
from fleetpose.evaluation.report.output import new_figure

ANGLE_STEP_DEG = 10.0
OVERLAP_STEP = 0.1
_LEAST_ERROR = 1e-2  # smaller ones are drawn there: the axis is logarithmic


def plot_all(out: Path, rows: Sequence[PairRow], median_depth_m: float) -> dict[str, Path]:
    """Draws all plots into a folder; returns the files by what they show, in reading order."""
    answered = [row for row in rows if row.T_i_j is not None]
    errors = [row.position_error_m or 0.0 for row in answered]
    turns = [row.rotation_error_deg or 0.0 for row in answered]
    plots = {
        "recall over angle": out / "recall_over_angle.png",
        "recall over overlap": out / "recall_over_overlap.png",
        "precision and recall of the verdict": out / "precision_recall.png",
        "position error": out / "position_error.png",
        "rotation error": out / "rotation_error.png",
        "error in units of its own covariance": out / "nees.png",
        "time": out / "align_ms.png",
        "reliability of the probability of a grave error": out / "reliability.png",
    }
    files = list(plots.values())
    plot_recall(files[0], rows, "angle_deg", ANGLE_STEP_DEG, "angle between the optical axes, deg")
    if any(row.overlap is not None for row in rows):
        plot_recall(files[1], rows, "overlap", OVERLAP_STEP, "overlap")
    else:
        del plots["recall over overlap"]
    plot_precision_recall(files[2], rows)
    shares = [100 * error / median_depth_m for error in errors]
    _plot_errors(files[3], answered, shares, "position error, % of the median depth")
    _plot_errors(files[4], answered, turns, "rotation error, deg")
    plot_nees(files[5], rows)
    plot_times(files[6], rows)
    plot_reliability(files[7], [r.p_grave for r in answered], [r.grave for r in answered])
    return plots


def plot_recall(path: Path, rows: Sequence[PairRow], field: str, step: float, label: str) -> None:
    """Shares over a property of the pairs, with bootstrap intervals and the number of pairs."""
    figure, axes = new_figure()
    bins: dict[int, list[PairRow]] = {}
    for row in rows:
        if (value := getattr(row, field)) is not None:
            bins.setdefault(int(value // step), []).append(row)
    places = sorted(bins)
    for name, shift, flag in (
        ("right", -0.1, lambda row: row.ok),
        ("not gravely wrong", 0.0, lambda row: row.T_i_j is not None and not row.grave),
        ("verified and right", 0.1, lambda row: row.ok and row.verdict == "verified"),
    ):
        found = [
            share_over_views([(row.i, row.j) for row in bins[b]], [flag(row) for row in bins[b]])
            for b in places
        ]
        values = np.array([(one.share, one.low, one.high) for one in found], float).reshape(-1, 3)
        spread = np.abs(values[:, 1:] - values[:, :1]).T
        x = (np.array(places) + 0.5 + shift) * step
        axes.errorbar(x, values[:, 0], spread, marker="o", capsize=3, label=name)
    for b in places:
        axes.annotate(str(len(bins[b])), ((b + 0.5) * step, 0.01), fontsize=7, ha="center")
    axes.set(xlabel=label, ylabel="share of the pairs", ylim=(0, 1.05))
    axes.grid(alpha=0.3)
    axes.legend(loc="best")
    figure.savefig(path)


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


def plot_nees(path: Path, rows: Sequence[PairRow]) -> None:
    """Squared error in units of the stated covariance, beside what a right covariance gives."""
    from scipy.stats import chi2

    figure, axes = new_figure()
    edges = np.linspace(0, 6, 37)
    values = np.minimum(np.array(verified_nees(rows)) / 6, edges[-1])
    if len(values):
        axes.hist(values, edges, density=True, alpha=0.6, label=f"{len(values)} verified pairs")
    axes.plot(edges, 6 * chi2.pdf(6 * edges, 6), label="a right covariance")
    axes.set(xlabel="NEES per degree of freedom; the last bar holds all beyond", ylabel="density")
    axes.legend()
    figure.savefig(path)


def plot_times(path: Path, rows: Sequence[PairRow]) -> None:
    """Milliseconds per pair."""
    figure, axes = new_figure()
    _stacked(axes, rows, [row.align_ms for row in rows], 40)
    axes.set(xlabel="ms per pair, views prepared", ylabel="pairs")
    figure.savefig(path)


def _plot_errors(path: Path, rows: Sequence[PairRow], values: Sequence[float], label: str) -> None:
    figure, axes = new_figure()
    largest = max([1.0, *values])
    edges = np.geomspace(_LEAST_ERROR, 1.001 * largest, 40)
    _stacked(axes, rows, np.maximum(values, edges[0]), edges)
    axes.set(xscale="log", xlabel=label, ylabel="answered pairs")
    figure.savefig(path)


def _stacked(axes: Any, rows: Sequence[PairRow], values: Any, bins: Any) -> None:
    """A histogram, its bars divided by verdict."""
    by_verdict = {
        verdict: [v for row, v in zip(rows, values, strict=True) if row.verdict == verdict]
        for verdict in VERDICTS
    }
    given = {verdict: some for verdict, some in by_verdict.items() if some}
    if given:
        axes.hist(list(given.values()), bins, stacked=True, label=list(given))
        axes.legend()
