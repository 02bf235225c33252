"""What questions save an operator: the bootstrap, and the loop on a small fleet."""

import csv
import json

import numpy as np
import pytest

from fleetpose.evaluation.bench.questions import play as playing
from fleetpose.evaluation.bench.questions.command import QuestionsOptions, run
from fleetpose.evaluation.bench.questions.play import Played, Run, Task
from fleetpose.evaluation.bench.questions.policies import POLICIES
from fleetpose.evaluation.bench.questions.report import (
    mean_with_interval,
    ratio_interval,
    summarize,
)
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.metrics.geometry import inverse
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.protocol.errors import DataFolderError
from tests.evaluation.makers import pose, write_posed_views, write_rgbd


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
    ends = {key: summary[key] for key in summary if key.startswith("grave_ends")}
    assert ends == dict.fromkeys(
        ("grave_ends_questions", "grave_ends_largest", "grave_ends_random"), 0
    )
    assert summary["suggestions_true"] == 0.5 and summary["suggestions_true_first"] == 1.0


class Claiming:
    """A server all of whose robots claim to be located, one of them wrong until so many visits."""

    def __init__(self, recording, wrong_for: int) -> None:
        self.views = {f"r{view.index}": view.index for view in recording.usable}
        self.components = [set(self.views)]
        self.visits, self._wrong_for, self._recording = 0, wrong_for, recording
        self.site = type("Site", (), {"anchor": "r0"})()

    def located_cameras(self):
        poses = {name: self._recording.views[k].T_world_camera for name, k in self.views.items()}
        if self.visits < self._wrong_for:
            poses["r1"] = poses["r1"] @ inverse(pose(t=(5.0, 0.0, 0.0)))
        return poses

    def is_verified(self, robot):
        return True

    def visit(self, pair, clicks):
        self.visits += 1


@pytest.mark.parametrize("asks", [True, False])
def test_a_fleet_that_only_claims_to_be_located_is_no_success(tmp_path, monkeypatch, asks):
    write_posed_views(tmp_path / "set", count=3)
    recording = open_recording(tmp_path / "set", "sparse_noisy")
    monkeypatch.setattr(playing, "clicks_in", lambda *_: [(np.zeros(2), np.zeros(2))] * 3)
    monkeypatch.setitem(POLICIES, "random", lambda *_: ("r0", "r1") if asks else None)
    server = Claiming(recording, wrong_for=2)
    run = playing.asked(Task(recording, {}, 0, Limits.of(2.0, rgbd=False)), server, "random")
    assert run.claimed
    assert run.located == asks and run.grave != asks
    assert run.clicks == (6 if asks else 30)  # two visits; all that were allowed


def test_grave_ends_are_counted_by_policy():
    ended = played((3, 9, 30))
    ended.runs[2].grave = True
    summary = summarize([ended, played((3, 9, 30))], list(POLICIES))
    assert (summary["grave_ends_questions"], summary["grave_ends_random"]) == (0, 1)


def test_every_policy_asks_until_all_are_located_and_right_or_no_click_is_left(tmp_path):
    # points so few that clicks hit the right ones, and depths so sure that three tell a rotation
    write_posed_views(tmp_path / "set", count=4, points=110, c2=0.002)
    options = QuestionsOptions(tmp_path / "set", "sparse_noisy", seeds=1, workers=1)
    summary = run(options, tmp_path / "out")
    with (tmp_path / "out" / "runs.csv").open(newline="") as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert rows.keys() == POLICIES.keys() and rows["questions"]["asked"]
    for policy, row in rows.items():
        most, asked = 10 * int(row["robots"]), len(row["asked"].split())
        made = min(3 * asked - int(row["in_vain"]), most)  # two images in vain cost two
        assert int(row["clicks"]) == (made if row["located"] == "1" else most)
        assert summary["failures"][policy] == (row["located"] == "0")
        assert not (row["located"] == "1" and row["grave"] == "1")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["fleets"] == 1
    assert (tmp_path / "out" / "clicks.png").stat().st_size > 1000


def test_a_recording_that_no_operator_can_help_is_named(tmp_path):
    write_rgbd(tmp_path / "walk", count=1)
    with pytest.raises(DataFolderError, match="needs an operator"):
        run(QuestionsOptions(tmp_path / "walk", seeds=1, workers=1), tmp_path / "out")
