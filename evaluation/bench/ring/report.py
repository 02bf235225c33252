"""The results of `pose-eval ring`: ring.csv, poses.csv, summary.json; what they say of the paper's
statements.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.clicks.rows import ClickRow, write_rows
from fleetpose.evaluation.bench.ring.figures import RECIPES, plot_error_and_success, plot_times
from fleetpose.evaluation.bench.ring.layout import Ring
from fleetpose.evaluation.bench.ring.solving import Solved
from fleetpose.evaluation.bench.ring.statements import THREE, statements
from fleetpose.evaluation.metrics.scoring import percentile, share
from fleetpose.evaluation.report.output import print_table, write_csv, write_summary

_SLACK = 0.001  # of the median depth: errors far below what clouds can tell are equal


@dataclass(frozen=True)
class RingRow:
    """All rings of one separation with one number of clicks.

    Attributes:
        separation_deg: between neighbours.
        clicks: on every pair of true neighbours.
        robots, pairs: in all rings.
        position_error_m: mean over all robots and draws after the fleet solve, the anchor as gauge.
            One that is not located counts, by one rule for both recipes: it is taken to stand where
            its neighbour does, which is the paper's start without clicks.
        success: share of the pairs, before the fleet solve, that are ok.
        icp_ms, align_ms: means per pair; all ICP counts, whichever step of an alignment it serves.
        located: share of the robots that are joined with their anchor.
        position_error_median_m: like the mean.
        pair_error_median_m: median of the pairs' own position errors; no answer counts as infinite.
        named: share of the alignments with wrong clicks in which exactly these were marked.
        success_right_clicks: success of these alignments without their wrong clicks.
    """

    separation_deg: float
    clicks: int
    robots: int
    pairs: int
    position_error_m: float | None
    success: float | None
    icp_ms: float
    align_ms: float
    located: float
    position_error_median_m: float | None
    pair_error_median_m: float | None
    named: float | None = None
    success_right_clicks: float | None = None


def ring_row(
    rings: Sequence[Ring], clicks: int, fleets: Sequence[Solved], rows: Sequence[ClickRow]
) -> RingRow:
    """Sums up the fleets and pairs of one separation and one number of clicks."""
    errors = [error for fleet in fleets for error in fleet.errors_m.values()]
    pair_errors = [np.inf if r.position_error_m is None else r.position_error_m for r in rows]
    return RingRow(
        separation_deg=rings[0].separation_deg,
        clicks=clicks,
        robots=sum(len(ring.views) for ring in rings),
        pairs=len({(row.i, row.j) for row in rows}),
        position_error_m=float(np.mean(errors)) if errors else None,
        success=share(row.ok for row in rows),
        icp_ms=float(np.mean([row.icp_ms for row in rows])),
        align_ms=float(np.mean([row.align_ms for row in rows])),
        located=float(np.mean([fleet.located for fleet in fleets])),
        position_error_median_m=percentile(errors, 50),
        pair_error_median_m=percentile(pair_errors, 50),
        named=share(row.named for row in rows if row.named is not None),
        success_right_clicks=share(
            row.ok_right_only for row in rows if row.ok_right_only is not None
        ),
    )


def write_results(
    out: Path,
    recipe: str,
    table: Sequence[RingRow],
    rows: Sequence[ClickRow],
    median_depth_m: float,
) -> dict[str, Any]:
    """Writes ring.csv, poses.csv and pairs.csv of one recipe; returns its summary."""
    cells = [vars(row) for row in table]
    write_csv(out / "ring.csv", [field.name for field in fields(RingRow)], cells)
    write_rows(out, rows)
    shown = {"separation_deg": "deg", "clicks": "clicks",
             "position_error_m": "mean m", "position_error_median_m": "median m",
             "located": "located", "success": "success",
             "icp_ms": "icp ms", "align_ms": "align ms"}  # fmt: skip
    print_table(
        f"{recipe} recipe",
        list(shown.values()),
        [[_short(cell[name]) for name in shown] for cell in cells],
    )
    said = statements(cells)
    for statement in said:
        print(f"{recipe}: {statement.line}")
    wrong = [row for row in rows if row.named is not None]
    summary: dict[str, Any] = {
        "recipe": recipe,
        "median_depth_m": median_depth_m,
        "pairs": len({(row.i, row.j) for row in rows}),
        "rings": cells,
        "statements": [asdict(statement) for statement in said],
    }
    if recipe == "paper":
        from fleetpose.pose_server.geometry.icp import has_open3d

        summary["icp"] = "open3d" if has_open3d() else "small_gicp"
    if wrong:
        summary["wrong_clicks"] = {
            "alignments": len(wrong),
            "named": share(bool(row.named) for row in wrong),
            "success": share(row.ok for row in wrong),
            "success_right_clicks": share(bool(row.ok_right_only) for row in wrong),
        }
    return summary


def write_summaries(out: Path, summaries: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Writes summary.json and the figures; both recipes together where both are there.

    A recipe that an earlier run left in the same folder is drawn beside the new one.
    """
    if len(summaries) > 1:
        for recipe, summary in summaries.items():
            write_summary(out / recipe, summary)
    alone = len(summaries) == 1
    written: dict[str, Any] = dict(next(iter(summaries.values())) if alone else summaries)
    both = {**_earlier(out), **summaries}
    if set(RECIPES) <= set(both):
        beside = compared(both)
        written["full_without_clicks_beside_paper_with_three"] = beside
        written["separations"] = len(beside)
        written["separations_met"] = sum(one["met"] for one in beside)
        written["separations_met_by_mean"] = sum(one["met_by_mean"] for one in beside)
        _print_compared(beside)
    write_summary(out, written)
    plot_error_and_success(out / "fig9.png", both)
    plot_times(out / "fig10.png", both)
    return written


def compared(summaries: Mapping[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The full recipe without clicks beside the paper's with three, at every separation.

    All robots count, whether they are located or not. The share of pairs that are ok must not be
    lower, and the position error not be larger: its median by more than 0.1 % of the median depth
    (`met`), its mean by nothing at all (`met_by_mean`). A mean tells mostly of the few robots that
    are lost, the median of the others.
    """
    slack_m = _SLACK * summaries["full"]["median_depth_m"]
    paper = {r["separation_deg"]: r for r in summaries["paper"]["rings"] if r["clicks"] == THREE}
    found = []
    for full in summaries["full"]["rings"]:
        beside = paper.get(full["separation_deg"])
        if full["clicks"] != 0 or beside is None:
            continue
        mean_m, paper_mean_m = (_finite(r["position_error_m"]) for r in (full, beside))
        median_m, paper_median_m = (_finite(r["position_error_median_m"]) for r in (full, beside))
        as_many = full["success"] >= beside["success"]
        found.append(
            {
                "separation_deg": full["separation_deg"],
                "success": full["success"],
                "paper_success": beside["success"],
                "position_error_median_m": median_m,
                "paper_position_error_median_m": paper_median_m,
                "position_error_m": mean_m,
                "paper_position_error_m": paper_mean_m,
                "met": as_many and median_m <= paper_median_m + slack_m,
                "met_by_mean": as_many and mean_m <= paper_mean_m,
            }
        )
    return found


def _print_compared(beside: Sequence[Mapping[str, Any]]) -> None:
    values = ("success", "position_error_median_m", "position_error_m")
    print_table(
        "full recipe without clicks / paper's with three",
        ["deg", "success", "median m", "mean m", "met", "met by mean"],
        [
            [
                row["separation_deg"],
                *(f"{row[value]:.2g} / {row[f'paper_{value}']:.2g}" for value in values),
                *("yes" if row[met] else "no" for met in ("met", "met_by_mean")),
            ]
            for row in beside
        ],
    )


def _short(value: Any) -> Any:
    """Three digits, so that the table fits a terminal of 80 columns; ring.csv has them all."""
    return f"{value:.3g}" if isinstance(value, float) else value


def _earlier(out: Path) -> dict[str, dict[str, Any]]:
    """The summary that an earlier run with one recipe left, by recipe."""
    try:
        summary = json.loads((out / "summary.json").read_text())
        return {recipe: summary for recipe in (summary.get("recipe"),) if recipe in RECIPES}
    except (OSError, ValueError, AttributeError):
        return {}


def _finite(value: float | None) -> float:
    return np.inf if value is None else float(value)
