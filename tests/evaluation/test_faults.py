"""The faults, small: nothing is lost, nobody is held up; how long it takes is not tested here."""

import csv

import pytest

from evaluation.faults import command, inject, late
from evaluation.faults.command import FaultOptions
from evaluation.faults.frozen import _longest_gap
from protocol.errors import FleetPoseError


@pytest.mark.timeout(300)
def test_kills_and_a_frozen_client_cost_no_click_and_leave_no_process(tmp_path):
    summary = command.run(FaultOptions(kills=4, freeze_s=2.0, seed=6), tmp_path)
    assert summary["receipted"] > 20 and summary["settled"]
    assert summary["kills_desk"] > 0 and summary["receipted_desk"] > 0
    assert summary["lost"] == summary["doubled"] == summary["leftover_processes"] == 0
    assert summary["gap_states_frozen_s"] > 0 and summary["caught_up_s"] > 0
    with (tmp_path / "kills.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and all(float(row["recovery_s"]) > 0 for row in rows)


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
        command.run(FaultOptions(), tmp_path)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("fault", ["clock", "person"])
def test_a_fault_is_named_and_makes_no_grave_pose(tmp_path, fault):
    (tmp_path / "scratch").mkdir()
    found = inject.run(
        fault, 90.0, tmp_path / "scratch", tmp_path / "o/logs/x", lambda: None, until_named=True
    )
    assert found[f"{fault}_named"] and found[f"{fault}_false_alarms"] == 0
    assert found[f"{fault}_grave_located"] == found[f"{fault}_leftover_processes"] == 0


def test_an_unknown_fault_is_said(tmp_path):
    with pytest.raises(FleetPoseError, match="there are none, skew"):
        command.run(FaultOptions(inject=("flood",)), tmp_path)
