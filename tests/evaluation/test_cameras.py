"""Rows of `pose-eval cameras` on a small selection, and damaged files."""

import random

import pytest

from fleetpose.evaluation.bench.cameras import cases, layouts, robots
from fleetpose.evaluation.bench.cameras.bars import Attempt, Bar
from fleetpose.evaluation.bench.cameras.command import run
from fleetpose.evaluation.bench.cameras.made import lost, stereo_variants, tables
from fleetpose.evaluation.bench.cameras.made.scene import RIG, seen
from fleetpose.evaluation.system.fuzz import files
from fleetpose.robot_agent.checking.report import check_rig


@pytest.mark.parametrize("variant", tables.VARIANTS, ids=lambda one: one.name)
def test_tables_of_other_systems_units_and_clocks_are_read_or_refused(variant, tmp_path):
    attempt = cases.tried(variant, tmp_path / "folder")
    assert attempt.met, attempt.says


def test_what_belongs_together_is_found_whichever_images_are_lost(tmp_path):
    assert not Bar("lost", lost.attempts(tmp_path)).failed


@pytest.mark.parametrize(
    "name", ["t_in_cm", "double_size_not_stated", "fisheye_narrow", "t_inverted", "vertical"]
)
def test_stereo_folders_are_read_or_refused(name, tmp_path):
    (variant,) = (one for one in stereo_variants.VARIANTS if one.name == name)
    attempt = cases.tried(variant, tmp_path / "folder")
    assert attempt.met, attempt.says


@pytest.mark.parametrize("name", ["euroc", "eth3d_stereo", "film_top_bottom", "pgm_seven_scenes"])
def test_layouts_are_opened_as_downloaded(name, tmp_path):
    (variant,) = (one for one in layouts.VARIANTS if one.name == name)
    attempt = cases.tried(variant, tmp_path / "folder")
    assert attempt.met, attempt.says


def test_a_decentred_lens_is_blamed_on_nobody():
    report = check_rig([seen(0, -0.0025).pair], RIG)
    assert report.verdict == "cannot tell" and report.T_right_left is None


@pytest.mark.parametrize("name", [robots.SOUND, "eyes are swapped", "97 % of the depth is lost"])
def test_a_camera_that_fails_is_named_and_a_sound_one_is_not(name):
    failed = [one for one in robots.tried(name) if not one.met]
    assert not failed


def test_a_refusal_helps_only_with_a_place_and_a_remedy():
    assert cases.helps("stereo.json, line 3: give fx in pixels")
    assert not cases.helps("too many values to unpack")


def test_damaged_files_are_read_or_refused(tmp_path):
    summary = files.run(400, tmp_path, seed=1)
    assert files.passed(summary), summary
    assert summary["read"] and summary["refused"]
    assert not files.passed({**summary, "counted": 399})
    assert files.damaged(random.Random(1), b"fx: 1") == files.damaged(random.Random(1), b"fx: 1")


def test_a_row_is_met_by_enough_of_some(tmp_path, monkeypatch):
    good, bad = Attempt("a", True, ""), Attempt("b", False, "said")
    assert Bar("x", [good, bad], 1).is_met and not Bar("x", [good, bad]).is_met
    assert not Bar("x").is_met
    monkeypatch.setattr(
        "fleetpose.evaluation.bench.cameras.command.bars_of", lambda *_: [Bar("x", [good, bad])]
    )
    assert not run(None, None, tmp_path / "out")
    assert "b,False,said" in (tmp_path / "out/attempts.csv").read_text()
