"""What questions save an operator: the bootstrap, and the loop on a small fleet."""

import csv
import json

import numpy as np
import pytest

from evaluation.questions.command import QuestionsOptions, run
from evaluation.questions.play import Played, Run
from evaluation.questions.policies import POLICIES
from evaluation.questions.report import mean_with_interval, ratio_interval, summarize
from protocol.errors import DataFolderError
from tests.evaluation.makers import write_posed_views, write_rgbd


def played(clicks, minimum=3):
    runs = [
        Run(0, name, 8, 2, minimum, n, n < 80) for name, n in zip(POLICIES, clicks, strict=True)
    ]
    return Played(runs, [(0, True), (0, True), (1, False), (2, False)])


def test_interval_holds_the_mean_and_shrinks_with_more_fleets():
    rng = np.random.default_rng(0)
    few, many = rng.gamma(2.0, 3.0, 10), rng.gamma(2.0, 3.0, 1000)
    widths = []
    for values in (few, many):
        found = mean_with_interval(values)
        assert found["low"] <= found["mean"] <= found["high"]
        widths.append(found["high"] - found["low"])
    assert widths[1] < widths[0]


def test_bootstrap_of_a_ratio_is_paired():
    rng = np.random.default_rng(1)
    hard = rng.gamma(1.0, 20.0, 30) + 3
    low, high = ratio_interval(0.5 * hard, hard)
    assert np.isclose(low, 0.5) and np.isclose(high, 0.5)
    low, high = ratio_interval(0.5 * rng.permutation(hard), hard)
    assert high - low > 0.05


def test_summary_has_the_keys_that_others_read():
    summary = summarize([played((3, 9, 30)), played((5, 20, 80), 6)], list(POLICIES))
    assert summary["clicks_questions"]["mean"] == 4.0
    assert summary["clicks_minimum"] == 4.5
    assert np.isclose(summary["ratio_minimum"], 4 / 4.5)
    assert summary["ratio_largest_high"] == summary["ratio_largest_error_high"] <= 0.34
    assert set(summary["clicks_random"]) == {"mean", "low", "high"}
    assert summary["failures"] == {"questions": 0, "largest_error": 0, "random": 1}
    assert summary["suggestions_true"] == 0.5 and summary["suggestions_true_first"] == 1.0


def test_a_fleet_of_pictures_without_features_is_located_by_clicks(tmp_path):
    write_posed_views(tmp_path / "set", count=5)
    options = QuestionsOptions(tmp_path / "set", "sparse_noisy", seeds=1, workers=1)
    summary = run(options, tmp_path / "out")
    with (tmp_path / "out" / "runs.csv").open(newline="") as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert rows.keys() == POLICIES.keys()
    asked = rows["questions"]
    assert asked["located"] == "1"
    assert int(asked["minimum"]) <= int(asked["clicks"]) <= 10 * int(asked["robots"])
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["fleets"] == 1
    assert summary["failures"]["questions"] == 0
    assert (tmp_path / "out" / "clicks.png").stat().st_size > 1000


def test_a_recording_that_no_operator_can_help_is_named(tmp_path):
    write_rgbd(tmp_path / "walk", count=1)
    with pytest.raises(DataFolderError, match="needs an operator"):
        run(QuestionsOptions(tmp_path / "walk", seeds=1, workers=1), tmp_path / "out")
