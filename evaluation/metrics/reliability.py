"""Does a stated probability come true as often as it says?"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetpose.evaluation.report.output import new_figure

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
    figure, axes = new_figure()
    bins, stated, came = _bins(p), np.asarray(p, float), np.asarray(true, float)
    axes.plot([0, 1], [0, 1], color="grey", label="as stated")
    for b in np.unique(bins):
        some = bins == b
        sigma = np.sqrt(
            max(came[some].mean() * (1 - came[some].mean()), 0.25 / some.sum()) / some.sum()
        )
        axes.errorbar(stated[some].mean(), came[some].mean(), sigma, marker="o", color="C0")
        axes.annotate(f" {some.sum()}", (stated[some].mean(), came[some].mean()), fontsize=8)
    axes.set(xlabel="stated probability of a grave error", ylabel="share that is gravely off")
    axes.set_title(f"expected calibration error {expected_calibration_error(p, true):.3f}")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left")
    figure.savefig(path)


def _bins(p: Sequence[float]) -> np.ndarray:
    return np.minimum((np.asarray(p, float) * BINS).astype(int), BINS - 1)
