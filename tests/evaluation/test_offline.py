"""Fleets without network: drawn views, the server's own order of work, and the truth beside it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fleetpose.evaluation.__main__ import app
from fleetpose.evaluation.bench.offline.command import run
from fleetpose.evaluation.bench.offline.fleet import Fleet, Placed, draw_views
from fleetpose.evaluation.bench.offline.report import summarize, worst_first
from fleetpose.evaluation.data.covisibility import Sights, chained, paired_up
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.data.parts import checked_views
from fleetpose.evaluation.options.fleets import FleetOptions
from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from tests.data import shared_data
from tests.evaluation.makers import write_posed_views, write_rgbd

RIGHT = Placed(0, 0, False, True, True, True, 0.01, 0.1, "verified", False, "")
GRAVE = replace(RIGHT, position_error_m=33.0, grave=True)
LOST = replace(RIGHT, located=False, position_error_m=None, why_not="nothing joins it")


def fleet(*robots: Placed, finished: bool = True) -> Fleet:
    return Fleet(robots, (), 1, finished)


def test_a_located_robot_that_is_gravely_off_is_never_a_located_right_one():
    summary = summarize([fleet(RIGHT, GRAVE, LOST), fleet(RIGHT, replace(LOST, together=False))])
    assert summary["grave_located"] == 1
    assert summary["robots"] == 5 and summary["robots_seen_together"] == 4
    assert summary["located"] == 3 / 5
    assert summary["located_right"] == 2 / 4
    assert summary["robots_in_reach"] == 5 and summary["located_right_in_reach"] == 2 / 5
    assert summary["position_error_max_m"] == 33.0


def test_a_fleet_that_was_not_finished_is_told():
    assert summarize([fleet(RIGHT), fleet(RIGHT, finished=False)])["unfinished"] == 1


def test_the_worst_folder_comes_first():
    lines = [
        {"data": name, **summarize([fleet(*robots)])}
        for name, robots in {"good": [RIGHT], "lost": [RIGHT, LOST], "grave": [GRAVE]}.items()
    ]
    assert [line["data"] for line in worst_first(lines)] == ["grave", "lost", "good"]


def test_draws_are_within_bounds_repeatable_and_without_partners(tmp_path):
    write_posed_views(tmp_path / "set", count=8)
    recording = open_recording(tmp_path / "set", "stereo_pair_sparse")
    draws = [draw_views(recording, None, seed) for seed in range(20)]
    assert all(2 <= len(set(draw)) == len(draw) <= 4 for draw in draws)  # 8 views, 4 pairs of eyes
    assert draws == [draw_views(recording, None, seed) for seed in range(20)]
    assert len(set(draws)) > 5
    assert all(a ^ 1 not in draw for draw in draws for a in draw)
    with pytest.raises(DataFolderError, match="views for 9 robots"):
        draw_views(recording, 9, 0)


def test_views_that_are_not_there_are_refused(tmp_path):
    write_posed_views(tmp_path / "set", count=3)
    recording = open_recording(tmp_path / "set", "sparse")
    assert [view.index for view in checked_views(recording, (2, 0))] == [2, 0]
    for views in ((0, 7), (1, 1), (1,), (0, 3)):  # 3 has no cloud
        with pytest.raises(DataFolderError, match="--views"):
            checked_views(recording, views)


def test_together_are_those_who_see_the_same_as_anyone():
    links = {(0, 1), (1, 0), (2, 3), (3, 2)}
    assert paired_up(range(5), lambda a, b: (a, b) in links) == {0, 1, 2, 3}


def test_a_chain_of_common_sights_joins():
    links = {(0, 3), (3, 4), (1, 2)}
    groups = chained(range(6), lambda a, b: (min(a, b), max(a, b)) in links)
    assert sorted(map(sorted, groups)) == [[0, 3, 4], [1, 2], [5]]


def test_views_see_the_same_by_tracks_or_by_depth(tmp_path):
    write_posed_views(tmp_path / "views", count=4, points=80)  # they see 80, 60, 40, 20 points
    posed = open_recording(tmp_path / "views", "sparse_noisy")
    assert sorted(map(sorted, Sights(posed).groups(posed.usable))) == [[0, 1, 2], [3]]
    write_rgbd(tmp_path / "rgbd", count=2)
    walk = open_recording(tmp_path / "rgbd")
    here, there = walk.usable
    away = replace(there, T_world_camera=there.T_world_camera + 0.0)
    away.T_world_camera[2, 3] += 10.0
    assert Sights(walk).same(here, there)
    assert not Sights(walk).same(here, away)


def test_a_fleet_at_named_views_is_put_together_and_scored(tmp_path):
    """Three neighbours of a real portal, and the other end of it."""
    options = FleetOptions(
        (shared_data("church_herzjesu"),), "sparse_noisy", views=(4, 5, 6), workers=1
    )
    summary = run(options, tmp_path)
    assert summary["fleets"] == 1 and summary["robots"] == 3
    assert summary["unfinished"] == summary["grave_located"] == 0
    assert summary["robots_seen_together"] == 3
    assert summary["located_right"] == 1.0
    written = json.loads((tmp_path / "summary.json").read_text())
    assert written["folders"][0]["located"] == 1.0 and written["grave"] == []
    assert len((tmp_path / "robots.csv").read_text().splitlines()) == 4


def test_a_server_that_believes_an_alias_is_caught(tmp_path, monkeypatch):
    """The count of grave robots would be worth nothing if it could not rise."""
    from fleetpose.evaluation.bench.offline import fleet as playing
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult

    write_posed_views(tmp_path / "set", count=2)
    alias = np.eye(4)
    alias[0, 3] = 5.0
    believed = PairResult(alias, np.eye(6) * 1e-8, "verified", (), inliers=99, overlap=0.9)
    monkeypatch.setattr(playing, "remembering", lambda folder: lambda job: believed)
    played = played_here(tmp_path, playing)
    assert sum(robot.grave for robot in played.robots) == 1
    assert all(robot.located for robot in played.robots)


def played_here(tmp_path, playing) -> Fleet:
    """A fleet of all views of the set, in this process."""
    import random

    from fleetpose.evaluation.bench.pairs.worker import encode
    from fleetpose.evaluation.data.anonymize import strip
    from fleetpose.evaluation.metrics.scoring import Limits

    recording = open_recording(tmp_path / "set", "sparse_noisy")
    wires = {}
    for view in recording.usable:
        name = f"robot{view.index}"
        stripped = strip(recording, [view], tmp_path / name, random.Random(0))
        wires[view.index] = tmp_path / f"{name}.msgpack"
        encode(name, stripped.camera, stripped.path, wires[view.index])
    limits = Limits.of(2.0, rgbd=False)
    return playing.play(playing.Task(recording, wires, 0, tuple(wires), limits))


def test_several_recordings_are_for_offline_fleets_only(tmp_path):
    both = [tmp_path / "one", tmp_path / "two"]
    assert FleetOptions().recording() is None
    with pytest.raises(FleetPoseError, match="only with --offline"):
        FleetOptions(tuple(both)).recording()
    with pytest.raises(DataFolderError, match="--data"):
        run(FleetOptions(()), tmp_path)


@pytest.mark.parametrize(
    "option",
    [("--recipe", "paper"), ("--world", "halls"), ("--moving",), ("--clicks-per-minute", "6")],
    ids=lambda option: option[0],
)
def test_what_only_live_fleets_have_is_refused_offline(tmp_path, option):
    result = CliRunner().invoke(app, ["fleet", "--offline", "--out", str(tmp_path), *option])
    assert result.exit_code != 0
    assert option[0] in str(result.exception) and "--offline" in str(result.exception)
