"""The plots of `pose-eval pairs`, each a PNG file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.pairs.row import VERDICTS, PairRow, share_of, verified_nees
from fleetpose.evaluation.metrics.reliability import plot_reliability
from fleetpose.evaluation.metrics.scoring import precision_recall, weakest_sigma_m
from fleetpose.evaluation.report.output import plot

ANGLE_STEP_DEG = 10.0
OVERLAP_STEP = 0.1
_LEAST_ERROR = 1e-2  # smaller ones are drawn there: the axis is logarithmic


def plot_all(out: Path, rows: Sequence[PairRow], median_depth_m: float) -> dict[str, Path]:
    """Draws all plots into a folder; returns the files by what they show, in reading order."""
    answered = [row for row in rows if row.T_i_j is not None]
    shares = [100 * (row.position_error_m or 0.0) / median_depth_m for row in answered]
    turns = [row.rotation_error_deg or 0.0 for row in answered]
    plots: dict[str, Path] = {}

    def file(what: str, name: str) -> Path:
        plots[what] = out / f"{name}.png"
        return plots[what]

    angle = file("recall over angle", "recall_over_angle")
    plot_recall(angle, rows, "angle_deg", ANGLE_STEP_DEG, "angle between the optical axes, deg")
    if any(row.overlap is not None for row in rows):
        overlap = file("recall over overlap", "recall_over_overlap")
        plot_recall(overlap, rows, "overlap", OVERLAP_STEP, "overlap")
    plot_precision_recall(file("precision and recall of the verdict", "precision_recall"), rows)
    position, rotation = (file(f"{one} error", f"{one}_error") for one in ("position", "rotation"))
    _plot_errors(position, answered, shares, "position error, % of the median depth")
    _plot_errors(rotation, answered, turns, "rotation error, deg")
    plot_nees(file("error in units of its own covariance", "nees"), rows)
    plot_times(file("time", "align_ms"), rows)
    reliability = file("reliability of the probability of a grave error", "reliability")
    plot_reliability(reliability, [r.p_grave for r in answered], [r.grave for r in answered])
    return plots


def plot_recall(path: Path, rows: Sequence[PairRow], field: str, step: float, label: str) -> None:
    """Shares over a property of the pairs, with bootstrap intervals; above them how many pairs."""
    bins: dict[int, list[PairRow]] = {}
    for row in rows:
        if (value := getattr(row, field)) is not None:
            bins.setdefault(int(value // step), []).append(row)
    places = sorted(bins)
    flags = (
        ("right", -0.1, lambda row: row.ok),
        ("not gravely wrong", 0.0, lambda row: row.T_i_j is not None and not row.grave),
        ("verified and right", 0.1, lambda row: row.ok and row.verdict == "verified"),
    )
    with plot(path, grid=True, xlabel=label, ylabel="share of the pairs", ylim=(0, 1.13)) as axes:
        for name, shift, flag in flags:
            found = [share_of(bins[b], [flag(row) for row in bins[b]]) for b in places]
            values = np.array([(s.share, s.low, s.high) for s in found], float).reshape(-1, 3)
            spread = np.abs(values[:, 1:] - values[:, :1]).T
            x = (np.array(places) + 0.5 + shift) * step
            axes.errorbar(x, values[:, 0], spread, marker="o", capsize=3, label=name)
        for b in places:
            axes.annotate(str(len(bins[b])), ((b + 0.5) * step, 1.08), fontsize=7, ha="center")


def plot_precision_recall(path: Path, rows: Sequence[PairRow]) -> None:
    """Precision over recall, answers accepted by verdict, within a verdict by stated sigma."""
    answered = [row for row in rows if row.T_i_j is not None]
    ok = [row.ok for row in answered]
    rank = [float(len(VERDICTS) - VERDICTS.index(row.verdict)) for row in answered]
    sigmas = [weakest_sigma_m(row.covariance) for row in answered]
    by_sigma = [(r, -sigma) for r, sigma in zip(rank, sigmas, strict=True)]
    about = {
        "xlabel": "recall: share of the right answers that are accepted",
        "ylabel": "precision: share of the accepted that are right",
        "title": f"{len(rows)} pairs, {len(answered)} answered, {sum(ok)} right",
    }
    with plot(path, legend="lower left", grid=True, xlim=(0, 1.02), ylim=(0, 1.02)) as axes:
        axes.set(**about)
        if answered:
            axes.plot(*precision_recall(by_sigma, ok), label="by verdict, then stated sigma")
            recall, precision = precision_recall([(r,) for r in rank], ok)
            given = [v for v in VERDICTS if any(row.verdict == v for row in answered)]
            for name, x, y in zip(given, recall, precision, strict=True):
                told = f"{name} or better: {100 * y:.1f} % right"
                axes.plot([x], [y], "o", label=told)


def plot_nees(path: Path, rows: Sequence[PairRow]) -> None:
    """Squared error in units of the stated covariance, beside what a right covariance gives."""
    from scipy.stats import chi2

    edges = np.linspace(0, 6, 37)
    values = np.minimum(np.array(verified_nees(rows)) / 6, edges[-1])
    label = "NEES per degree of freedom; the last bar holds all beyond"
    with plot(path, xlabel=label, ylabel="density") as axes:
        if len(values):
            told = f"{len(values)} verified pairs"
            axes.hist(values, edges, density=True, alpha=0.6, label=told)
        axes.plot(edges, 6 * chi2.pdf(6 * edges, 6), label="a right covariance")


def plot_times(path: Path, rows: Sequence[PairRow]) -> None:
    """Milliseconds per pair."""
    with plot(path, xlabel="ms per pair, views prepared", ylabel="pairs") as axes:
        _stacked(axes, rows, [row.align_ms for row in rows], 40)


def _plot_errors(path: Path, rows: Sequence[PairRow], values: Sequence[float], label: str) -> None:
    edges = np.geomspace(_LEAST_ERROR, 1.001 * max([1.0, *values]), 40)
    with plot(path, xscale="log", xlabel=label, ylabel="answered pairs") as axes:
        _stacked(axes, rows, np.maximum(values, edges[0]), edges)


def _stacked(axes: Any, rows: Sequence[PairRow], values: Any, bins: Any) -> None:
    """A histogram, its bars divided by verdict."""
    by_verdict = {
        verdict: [v for row, v in zip(rows, values, strict=True) if row.verdict == verdict]
        for verdict in VERDICTS
    }
    given = {verdict: some for verdict, some in by_verdict.items() if some}
    if given:
        axes.hist(list(given.values()), bins, stacked=True, label=list(given))
