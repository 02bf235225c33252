"""The faults, small: nothing is lost, nobody is held up; how long it takes is not tested here."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from fleetpose.evaluation.system.faults import command, inject
from fleetpose.evaluation.system.faults.command import FaultOptions
from fleetpose.evaluation.system.faults.frozen import _longest_gap
from fleetpose.evaluation.system.faults.inject import FAULTS, Watch
from fleetpose.evaluation.system.faults.troubles import FAULTY, ToldTruth, TwoHalls
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import Alarm


@pytest.mark.timeout(300)
def test_kills_and_a_frozen_client_cost_no_click_and_leave_no_process(tmp_path):
    summary = command.run(FaultOptions(kills=2, freeze_s=2.0, seed=6), tmp_path)
    assert summary["receipted"] > 10 and summary["settled"]
    assert summary["kills_desk"] > 0 and summary["receipted_desk"] > 0
    assert summary["lost"] == summary["doubled"] == summary["leftover_processes"] == 0
    assert summary["gap_states_frozen_s"] > 0 and summary["caught_up_s"] > 0
    with (tmp_path / "kills.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 and all(float(row["recovery_s"]) > 0 for row in rows)


def test_the_longest_gap_includes_both_ends():
    assert _longest_gap([1.0, 2.0, 2.5, 9.0], 0.0, 5.0) == 2.5
    assert _longest_gap([], 0.0, 5.0) == 5.0


def test_nothing_to_do_is_said(tmp_path):
    with pytest.raises(FleetPoseError, match="--kills"):
        command.run(FaultOptions(), tmp_path)


@pytest.mark.timeout(300)
def test_a_fault_is_named_and_makes_no_grave_pose(tmp_path):
    (tmp_path / "scratch").mkdir()
    found = inject.run(
        "clock", 90.0, tmp_path / "scratch", tmp_path / "o/logs/x", lambda: None, until_named=True
    )
    assert found["clock_named"] and found["clock_false_alarms"] == 0
    assert found["clock_grave_located"] == found["clock_leftover_processes"] == 0


def test_an_unknown_fault_is_said(tmp_path):
    with pytest.raises(FleetPoseError, match="there are none, skew"):
        command.run(FaultOptions(inject=("flood",)), tmp_path)


def heard(*alarms: tuple[str, str], events: tuple[str, ...] = ()) -> SimpleNamespace:
    """An observer that heard a state with these alarms, robot and kind."""
    told = tuple(Alarm(robot=robot, kind=kind, text=f"{kind} of {robot}") for robot, kind in alarms)
    return SimpleNamespace(state=SimpleNamespace(alarms=told, events=events))


def test_a_fault_is_named_at_its_robot_once_it_began_and_alarms_at_others_are_false():
    watch = Watch(FAULTS["kidnapped"])
    watch.look(heard((FAULTY, "lost")), -1.0)
    assert watch.named_s is None, "before it began"
    watch.look(heard(("r3", "lost"), (FAULTY, "skew")), 1.0)
    assert watch.named_s is None and watch.false_alarms == 1
    watch.look(heard((FAULTY, "lost")), 2.0)
    watch.look(heard((FAULTY, "lost")), 3.0)
    assert watch.named_s == 2.0 and watch.texts == [f"lost of {FAULTY}"]


def test_a_fault_of_all_robots_is_false_at_none_and_events_and_drops_name_as_well():
    watch = Watch(FAULTS["carried"])
    watch.look(heard(("r3", "carried")), 1.0)
    assert watch.named_s == 1.0 and watch.false_alarms == 0
    left = Watch(FAULTS["leave"])
    left.look(heard(events=(f"{FAULTY} is gone",)), 0.5)
    assert left.named_s == 0.5
    forged = Watch(FAULTS["old-epoch"])
    forged.look(heard(), 0.5, ["a pose of server x that is not alive"])
    assert forged.named_s == 0.5


def test_every_alarm_is_false_where_nothing_is_wrong():
    watch = Watch(FAULTS["none"])
    watch.look(heard((FAULTY, "lost"), ("r1", "still")), 1.0)
    assert watch.false_alarms == 2


def seen_by(robot: str, stamp_ns: int = 0, epoch: str = "0" * 12) -> SimpleNamespace:
    name = SimpleNamespace(robot=robot, epoch=epoch)
    return SimpleNamespace(view=SimpleNamespace(name=name, stamp_ns=stamp_ns))


def test_what_the_faulty_robot_told_of_its_frames_is_where_it_was(tmp_path):
    turned = np.array([[0.0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 0], [0, 0, 0, 1]])
    places = {"r2": np.eye(4).tolist(), "r6": turned.tolist()}
    (tmp_path / "truth").write_text(json.dumps({"radius_m": 1, "T_world_robots": places}))
    base = SimpleNamespace(T_world_robot=lambda seen: np.full((4, 4), 7.0))
    told = [
        {"stamp_ns": 1, "place": "r2", "driven_m": 2.0},
        {"stamp_ns": 2, "place": "r6", "driven_m": 1.0},
    ]
    truth = ToldTruth(base, tmp_path / "truth", told)
    assert truth.T_world_robot(seen_by("r1"))[0, 0] == 7.0
    assert truth.T_world_robot(seen_by(FAULTY, 1))[:3, 3].tolist() == [2.0, 0.0, 0.0]
    assert truth.T_world_robot(seen_by(FAULTY, 2))[:3, 3].tolist() == [3.0, 5.0, 0.0]
    assert truth.T_world_robot(seen_by(FAULTY, 3)) is None


def test_lives_that_began_in_the_other_hall_are_judged_by_its_truth():
    here, there = (SimpleNamespace(T_world_robot=lambda seen, k=k: k) for k in (1, 2))
    truth = TwoHalls(here, there, frozenset({"0" * 12}))
    assert truth.T_world_robot(seen_by("r1")) == 1
    assert truth.T_world_robot(seen_by("r1", epoch="1" * 12)) == 2
