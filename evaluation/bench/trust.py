"""`pose-eval trust`: fits the probability that a pose is gravely off to pairs whose truth is known,
and judges it on places that it was not fitted on.

It reads the `evidence.csv` that `pose-eval pairs` leaves, and prints the model as
`pose_server/pairs/trust_model.py` holds it.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.reliability import expected_calibration_error, plot_reliability
from fleetpose.evaluation.report.output import output_folder, print_table, write_summary
from fleetpose.pose_server.registration.verdict.evidence import Evidence
from fleetpose.pose_server.registration.verdict.explained import Explained
from fleetpose.pose_server.registration.verdict.grave_probability import (
    CHI2_SIGNS,
    SIGNS,
    TrustModel,
    circumstances,
    contrast,
    p_grave,
    shares,
    signs,
)
from fleetpose.pose_server.registration.verdict.words import judge
from fleetpose.protocol.errors import DataFolderError

# Of the weights, in units of their signs' scatter: every sign is expected to speak, the pairs at
# hand must not silence one that happens to say little in them.
_PRIOR, _RIDGE, _LEAST_OF_PRIOR = 0.4, 3.0, 0.75
# Of squared contrasts, as they are: half of what Gaussian scatter would give, for its tails are
# longer than that.
_PRIOR_OF_CHI2 = 0.25
# Aliases that are alike to the last texel: no evidence of the pair tells, the fleet must. They
# would teach that all right poses are doubtful.
_UNTOLD_LOG_ODDS = -1.5  # from 4.5 to one on
_MOST_OF_A_PLACE = 400.0  # pairs that a place counts as: none outvotes the others
_ROBUST_ROUNDS = 3
_PARTS = {field.name for field in fields(Explained)}
_WHOLE = {"inliers", "exact", "ratio_inliers", "ratio_matches", "rival", "rivalled", "compared"}
_WHOLE |= {"visible", "sides"}


@dataclass(frozen=True)
class Judged:
    """One pair of a place: its evidence, and whether the pose is gravely off or right."""

    place: str
    evidence: Evidence
    grave: bool
    ok: bool


def run(fitted: Sequence[Path], held_out: Sequence[Path], out: Path) -> dict[str, Any]:
    """Fits, judges, prints; returns the summary.

    Args:
        fitted: folders of `pose-eval pairs` to fit on.
        held_out: folders to judge on.
        out: folder for the results.

    Raises:
        DataFolderError: a folder has no evidence.
    """
    output_folder(out)
    train = [row for folder in fitted for row in read_evidence(folder)]
    test = [row for folder in held_out for row in read_evidence(folder)]
    model = fit(train)
    print(as_code(model, sorted({row.place for row in train})))
    summary: dict[str, Any] = {"fitted": [f.name for f in fitted], "places": []}
    for name, rows in (("fitted", train), ("held out", test)):
        for place in sorted({row.place for row in rows}):
            some = [row for row in rows if row.place == place]
            summary["places"].append({"place": place, "split": name, **confusion(some, model)})
        summary[f"expected_calibration_error_{name.replace(' ', '_')}"] = (
            _calibration_error(rows, model) if rows else None
        )
    columns = tuple(summary["places"][0])
    print_table("places", columns, [tuple(p.values()) for p in summary["places"]])
    if test:
        p = [p_grave(row.evidence, model) for row in test]
        plot_reliability(out / "reliability.png", p, [row.grave for row in test])
    write_summary(out, summary)
    return summary


def read_evidence(folder: Path) -> Iterator[Judged]:
    """The pairs of a folder that `pose-eval pairs` wrote.

    Raises:
        DataFolderError: there is no `evidence.csv`, or it is of another version.
    """
    path = folder / "evidence.csv"
    if not path.is_file():
        raise DataFolderError(f"{path} is missing: make it by `pose-eval pairs --out {folder}`")
    with path.open(newline="") as file:
        for cells in csv.DictReader(file):
            try:
                evidence = _evidence(cells)
            except KeyError as error:
                raise DataFolderError(f"{path} has no column {error}: make it anew") from error
            yield Judged(folder.name, evidence, cells["grave"] == "True", cells["ok"] == "True")


def _evidence(cells: dict[str, str]) -> Evidence:
    def number(name: str) -> Any:
        return int(float(cells[name])) if name in _WHOLE else float(cells[name])

    parts = Explained(**{name: number(name) for name in _PARTS})
    names = [field.name for field in fields(Evidence) if field.name != "explained"]
    return Evidence(**{name: number(name) for name in names}, explained=parts)


def fit(rows: Sequence[Judged]) -> TrustModel:
    """A model of all places, each counting the same at most."""
    right = [row for row in rows if row.ok]
    expected, scatter = _fit_expected(right)
    draft = TrustModel(
        tuple(map(tuple, expected.tolist())), tuple(scatter.tolist()), (0.0,) * len(SIGNS), 0.0
    )
    X = np.array([signs(r.evidence, contrast(draft, r.evidence)) for r in rows], np.float64)
    y = np.array([row.grave for row in rows], float)
    weights, bias = _fit_logistic(X, y, _place_weights(rows))
    for _ in range(_ROBUST_ROUNDS):
        told = (y == 0) | (X @ weights + bias > _UNTOLD_LOG_ODDS)
        weights, bias = _fit_logistic(X[told], y[told], _place_weights(rows)[told])
    return TrustModel(draft.expected, draft.scatter, tuple(weights.tolist()), bias)


def _fit_expected(right: Sequence[Judged]) -> tuple[Floats, Floats]:
    """(4, C) least squares of right poses' shares on their circumstances, and (4,) the scatter;
    outliers count less.
    """
    C = np.array([circumstances(row.evidence) for row in right])
    S = np.array([shares(row.evidence) for row in right])
    places = _place_weights(right)
    coefficients, scatter = np.zeros((S.shape[1], C.shape[1])), np.ones(S.shape[1])
    for k in range(S.shape[1]):
        w = places.copy()
        for _ in range(_ROBUST_ROUNDS):
            root = np.sqrt(w)[:, None]
            normal = (root * C).T @ (root * C) + 1e-3 * np.eye(C.shape[1]) * w.sum()
            coefficients[k] = np.linalg.solve(normal, (root * C).T @ (root[:, 0] * S[:, k]))
            off = S[:, k] - C @ coefficients[k]
            scatter[k] = max(1.4826 * float(np.median(np.abs(off))), 0.05)
            w = places / (1 + (off / (3 * scatter[k])) ** 2)
    return coefficients, scatter


def _place_weights(rows: Sequence[Judged]) -> Floats:
    counts: dict[str, int] = {}
    for row in rows:
        counts[row.place] = counts.get(row.place, 0) + 1
    return np.array([min(1.0, _MOST_OF_A_PLACE / counts[row.place]) for row in rows])


def _fit_logistic(X: Floats, y: Floats, w: Floats) -> tuple[Floats, float]:
    """Weights (S,) and bias of the log odds that y is 1, with a ridge around their prior: all >= 0,
    and so much of it at least.
    """
    scale = X.std(axis=0) + 1e-6
    Z = X / scale
    squared = np.array([name in CHI2_SIGNS for name in SIGNS])
    prior = np.where(squared, _PRIOR_OF_CHI2 * scale, _PRIOR)

    def cost(theta: Floats) -> tuple[float, Floats]:
        odds = Z @ theta[1:] + theta[0]
        loss = np.logaddexp(0, odds) - y * odds
        slope = w * (1 / (1 + np.exp(-odds)) - y)
        gradient = np.concatenate(([slope.sum()], Z.T @ slope + _RIDGE * (theta[1:] - prior)))
        return float((w * loss).sum() + 0.5 * _RIDGE * ((theta[1:] - prior) ** 2).sum()), gradient

    bounds = [(None, None), *((_LEAST_OF_PRIOR * one, None) for one in prior)]
    found = minimize(cost, np.zeros(X.shape[1] + 1), jac=True, method="L-BFGS-B", bounds=bounds)
    return found.x[1:] / scale, float(found.x[0])


def confusion(rows: Sequence[Judged], model: TrustModel) -> dict[str, Any]:
    """Of one place: pairs, verdicts, what is gravely off among them, and the calibration."""
    verdicts = [judge(row.evidence, p_grave(row.evidence, model))[0] for row in rows]
    right = [v for v, row in zip(verdicts, rows, strict=True) if row.ok]
    grave = [v for v, row in zip(verdicts, rows, strict=True) if row.grave]
    return {
        "pairs": len(rows),
        "ok": len(right),
        "ok_verified": right.count("verified") / max(len(right), 1),
        "grave": len(grave),
        "grave_verified": grave.count("verified"),
        "grave_plausible": grave.count("plausible"),
        "calibration_error": _calibration_error(rows, model),
    }


def _calibration_error(rows: Sequence[Judged], model: TrustModel) -> float:
    p = [p_grave(row.evidence, model) for row in rows]
    return expected_calibration_error(p, [row.grave for row in rows])


def as_code(model: TrustModel, places: Sequence[str]) -> str:
    """The model as the lines of `pose_server/pairs/trust_model.py`."""

    def rounded(values: Sequence[float]) -> str:
        return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"

    lines = [f"# fitted on {', '.join(places)}", "MODEL = TrustModel("]
    lines += ["    expected=(", *(f"        {rounded(row)}," for row in model.expected), "    ),"]
    lines += [f"    scatter={rounded(model.scatter)},", "    weights=("]
    named = zip(model.weights, SIGNS, strict=True)
    lines += [f"        {w:.4g},  # {name}" for w, name in named]
    lines += ["    ),", f"    bias={model.bias:.4g},", ")"]
    return "\n".join(lines)
