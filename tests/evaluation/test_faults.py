"""The faults, small: nothing is lost, nobody is held up; how long it takes is not tested here."""

import csv

import pytest

from evaluation.faults import command, late
from evaluation.faults.frozen import _longest_gap
from protocol.errors import FleetPoseError


@pytest.mark.timeout(300)
def test_kills_and_a_frozen_client_cost_no_click_and_leave_no_process(tmp_path):
    summary = command.run(kills=3, freeze_s=2.0, late_clicks=0, out=tmp_path, seed=1)
    assert summary["receipted"] > 20 and summary["settled"]
    assert summary["lost"] == summary["doubled"] == summary["leftover_processes"] == 0
    assert summary["gap_states_frozen_s"] > 0 and summary["caught_up_s"] > 0
    with (tmp_path / "kills.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 and all(float(row["recovery_s"]) > 0 for row in rows)


@pytest.mark.timeout(300)
def test_late_clicks_in_frozen_views_are_accepted_and_placed(tmp_path):
    (tmp_path / "scratch").mkdir()
    found = late.run(20, tmp_path / "scratch", tmp_path / "logs", lambda: None, late_s=5.0)
    assert found["late_clicks"] == 20 and found["late_rejected_unknown"] == 0
    assert found["late_accepted"] + sum(found["late_rejected_otherwise"].values()) == 20
    assert found["late_placed"] == found["late_accepted"] > 10


def test_the_longest_gap_includes_both_ends():
    assert _longest_gap([1.0, 2.0, 2.5, 9.0], 0.0, 5.0) == 2.5
    assert _longest_gap([], 0.0, 5.0) == 5.0


def test_nothing_to_do_is_said(tmp_path):
    with pytest.raises(FleetPoseError, match="--kills"):
        command.run(0, 0.0, 0, tmp_path)
