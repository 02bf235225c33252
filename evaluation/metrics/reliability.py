"""Does a stated probability come true as often as it says?"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetpose.evaluation.report.output import plot

BINS = 10


def expected_calibration_error(p: Sequence[float], true: Sequence[bool]) -> float:
    """Mean difference between stated probability and observed share over bins of equal width,
    weighed by their pairs (Naeini et al., AAAI 2015).
    """
    bins = _bins(p)
    stated, came = np.asarray(p, float), np.asarray(true, float)
    gaps = [
        (bins == b).sum() * abs(stated[bins == b].mean() - came[bins == b].mean())
        for b in np.unique(bins)
    ]
    return float(sum(gaps) / max(len(stated), 1))


def plot_reliability(path: Path, p: Sequence[float], true: Sequence[bool]) -> None:
    """Observed share of grave errors over the stated probability, with the number of pairs."""
    bins, stated, came = _bins(p), np.asarray(p, float), np.asarray(true, float)
    x, y = "stated probability of a grave error", "share that is gravely off"
    title = f"expected calibration error {expected_calibration_error(p, true):.3f}"
    with plot(path, legend="upper left", grid=True, title=title, xlabel=x, ylabel=y) as axes:
        axes.plot([0, 1], [0, 1], color="grey", label="as stated")
        for b in np.unique(bins):
            some = bins == b
            share, count = came[some].mean(), some.sum()
            sigma = np.sqrt(max(share * (1 - share), 0.25 / count) / count)
            axes.errorbar(stated[some].mean(), share, sigma, marker="o", color="C0")
            axes.annotate(f" {count}", (stated[some].mean(), share), fontsize=8)


def _bins(p: Sequence[float]) -> np.ndarray:
    return np.minimum((np.asarray(p, float) * BINS).astype(int), BINS - 1)
