"""`pose-eval persist` and `pose-eval clicks`: runs, intervals, and what they write."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.bench.clicks.command import ClicksOptions, interval, pairs_in_range
from fleetpose.evaluation.bench.clicks.rows import ClickRow
from fleetpose.evaluation.bench.persist.command import PersistOptions, run, runs_of, summarize
from fleetpose.evaluation.bench.persist.following import POLICIES, Step
from fleetpose.evaluation.bench.persist.walks import Walk
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.protocol.errors import DataFolderError
from tests.evaluation.makers import write_posed_views, write_rgbd


def walk(count):
    return Walk(tuple(Path(str(k)) for k in range(count)), np.tile(np.eye(4), (count, 1, 1)))


def row(i, j):
    return ClickRow(i, j, "verified", 1.0, None, None, np.eye(4), 50.0, None, None, True, False,
                    "features", 9, "")  # fmt: skip


def test_runs_go_forward_and_back_over_the_whole_walk():
    runs = runs_of(walk(7), walk(7), PersistOptions(views=4, runs=10))
    seen = [[int(str(wire)) for wire in one.a.wires] for one in runs]
    assert seen == [[0, 1, 2, 3, 4], [6, 5, 4, 3, 2], [1, 2, 3, 4, 5], [5, 4, 3, 2, 1],
                    [2, 3, 4, 5, 6], [4, 3, 2, 1, 0]]  # fmt: skip


def test_a_view_without_a_pose_counts_as_one_with_any_error():
    steps = [
        Step("with", 0, k, "verified", "alignment", 0.01 * k, 0.1, 1.0, 5.0) for k in (1, 2, 3)
    ]
    steps += [Step("without", 0, 1, "verified", "alignment", 0.01, 0.1, 2.0, 6.0)]
    steps += [Step("without", 0, k, "rejected", "none", None, None, 2.0, 6.0) for k in (2, 3)]
    others = ("without_but_carried", "paper_with", "paper_without")
    steps += [replace(step, policy=policy) for policy in others for step in steps[:3]]
    summary = summarize(steps, Limits.of(2.0, rgbd=True))
    assert summary["with"]["answered"] == 1.0
    assert summary["without"]["answered"] == pytest.approx(1 / 3)
    assert summary["without"]["position_error_median_all_m"] == np.inf
    assert summary["where_both_answer"]["steps"] == 1
    assert summary["where_both_answer"]["icp_ms_with"] == 1.0


def test_both_halves_of_a_walk_are_followed_by_every_policy(tmp_path):
    write_rgbd(tmp_path / "walk", count=6)
    options = PersistOptions(tmp_path / "walk", views=2, runs=1, workers=1)
    summary = run(options, tmp_path / "out")
    with (tmp_path / "out" / "persist.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sorted((r["policy"], r["step"]) for r in rows) == sorted(
        (policy, str(k)) for policy in POLICIES for k in (1, 2)
    )
    assert set(POLICIES) <= set(summary)
    assert (tmp_path / "out" / "persist.png").exists()


def test_posed_views_do_not_move(tmp_path):
    write_posed_views(tmp_path / "views")
    with pytest.raises(DataFolderError, match="synthetic world"):
        run(PersistOptions(tmp_path / "views", workers=1), tmp_path / "out")


def test_pairs_are_chosen_by_angle_and_by_what_they_share(tmp_path):
    write_posed_views(tmp_path / "set", count=5)
    recording = open_recording(tmp_path / "set", "sparse")
    options = ClicksOptions(tmp_path / "set", angles_deg=(15.0, 35.0), min_shared=230)
    pairs = pairs_in_range(recording, options)
    assert {(i.index, j.index) for i, j in pairs} == {(0, 2), (0, 3), (1, 3)}
    with pytest.raises(DataFolderError, match="--angles"):
        pairs_in_range(recording, ClicksOptions(tmp_path / "set", angles_deg=(90.0, 180.0)))


def test_the_interval_holds_the_share_and_is_wider_where_pairs_have_a_view_in_common():
    rows = [row(i, j) for i in range(12) for j in range(i)]
    assert interval(rows, [True] * len(rows)) == (1.0, 1.0)
    by_view = [0 in (one.i, one.j) for one in rows]  # all pairs of one view differ from the rest
    by_chance = np.random.default_rng(0).permutation(by_view).tolist()
    wide, narrow = interval(rows, by_view), interval(rows, by_chance)
    assert wide[0] <= np.mean(by_view) <= wide[1]
    assert wide[1] - wide[0] > narrow[1] - narrow[0]
