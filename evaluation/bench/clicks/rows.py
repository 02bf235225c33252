"""One row per alignment with clicks: what was answered, how right it is, what became of the wrong
clicks.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.clicks.worker import ClickedAnswer
from fleetpose.evaluation.bench.pairs.command import scored
from fleetpose.evaluation.bench.pairs.report import (
    POSE_FILE_COLUMNS,
    REMARK_COLUMNS,
    TRUTH_COLUMNS,
    PairRow,
)
from fleetpose.evaluation.bench.ring.solving import Mask
from fleetpose.evaluation.data.recording import TrueView
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.report.output import write_csv

CLICK_COLUMNS = ("clicks", "draw")
CLICK_TRUTH_COLUMNS = ("icp_ms", "ok", "made", "wrong", "named", "ok_right_only")


@dataclass
class ClickRow(PairRow):
    """A pair with clicks.

    Attributes:
        clicks: how many the operator was to make; `made` is fewer where the views share less.
        draw: number of the draw.
        icp_ms: spent in ICP.
        wrong: how many of the clicks are 50 px off.
        named: whether exactly these were marked; none where all are right.
        ok_right_only: whether the pose without the wrong clicks is ok; none where all are right.
    """

    clicks: int = 0
    draw: int = 0
    icp_ms: float = 0.0
    made: int = 0
    wrong: int = 0
    named: bool | None = None
    ok_right_only: bool | None = None


def click_row(
    pair: tuple[TrueView, TrueView],
    plan_clicks: int,
    draw: int,
    clicked: ClickedAnswer,
    limits: Limits,
    shared: int | None = None,
) -> ClickRow:
    """An answer beside the truth; who is named is found out by `named`."""
    right_only = clicked.right_only
    return ClickRow(
        **{**vars(scored(*pair, clicked.answer, limits)), "shared": shared},
        clicks=plan_clicks,
        draw=draw,
        icp_ms=clicked.icp_ms,
        made=len(clicked.wrong),
        wrong=int(clicked.wrong.sum()),
        ok_right_only=None if right_only is None else scored(*pair, right_only, limits).ok,
    )


def named(clicked: ClickedAnswer, marked: Mask | None) -> bool | None:
    """Whether exactly the wrong clicks are marked; none where all are right."""
    if not clicked.wrong.any():
        return None
    return marked is not None and bool(np.array_equal(marked, clicked.wrong))


def write_rows(out: Path, rows: Sequence[ClickRow]) -> None:
    """Writes poses.csv, without truth, and pairs.csv with it."""
    cells: list[dict[str, Any]] = [row.cells() for row in rows]
    poses = (*POSE_FILE_COLUMNS, *CLICK_COLUMNS)
    write_csv(out / "poses.csv", poses, cells)
    write_csv(
        out / "pairs.csv", (*poses, *TRUTH_COLUMNS, *CLICK_TRUTH_COLUMNS, *REMARK_COLUMNS), cells
    )
