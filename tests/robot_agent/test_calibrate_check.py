"""Calibrations good and bad against exact matches, rendered pairs, and the command itself."""

import json
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.simulate.stereo_video import lens_rig, shot_through_lenses
from fleetpose.evaluation.simulate.world.materials.textures import noise
from fleetpose.evaluation.simulate.world.render import Quad, Renderer
from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair
from fleetpose.robot_agent.cameras.stereo.rectify import Rectifier
from fleetpose.robot_agent.cameras.stereo.rig import content_of
from fleetpose.robot_agent.checking.command import known_length
from fleetpose.robot_agent.checking.findings import judged, parts_of, rig_findings
from fleetpose.robot_agent.checking.fit import fit_rig
from fleetpose.robot_agent.checking.matching import Matches
from fleetpose.robot_agent.checking.report import KnownLength, check_rig
from fleetpose.robot_agent.checking.scale import CheckError

RIG = lens_rig(10.0)
NOISE_PX = 0.3


def turned(axis, deg, rig=RIG):
    """The calibration of a rig whose right camera was turned afterwards where it stands."""
    T = rig.T_right_left.copy()
    T[:3] = cv2.Rodrigues(np.radians(deg) * np.eye(3)[axis])[0] @ T[:3]
    return replace(rig, T_right_left=T)


def pixels(points, K, D, T):
    return cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, D)[0].reshape(-1, 2)


def true_matches(calibration, rng, count=1500, depth_m=(4.0, 30.0), wrong=0.0, scene=RIG):
    """Matches of a scene that the true rig sees, rectified by a calibration."""
    z = 1 / rng.uniform(1 / depth_m[1], 1 / depth_m[0], count)
    x, y = rng.uniform(-0.5, 0.5, count), rng.uniform(-0.38, 0.38, count)
    points = np.column_stack((x, y, np.ones(count))) * z[:, None]
    rectifier = Rectifier(calibration)
    said = calibration
    eyes = (
        (scene.K_left, scene.D_left, np.eye(4), said.K_left, said.D_left),
        (scene.K_right, scene.D_right, scene.T_right_left, said.K_right, said.D_right),
    )
    turns = rectifier.R_rect_left, rectifier.R_rect_right
    seen = []
    for (K, D, T, K_said, D_said), R in zip(eyes, turns, strict=True):
        uv = pixels(points, K, D, T) + rng.normal(0, NOISE_PX, (count, 2))
        uv = cv2.undistortPoints(uv.reshape(-1, 1, 2), K_said, D_said, R=R, P=rectifier.K)
        seen.append(uv.reshape(-1, 2))
    astray = rng.random(count) < wrong
    seen[1][astray] = rng.uniform((0, 0), calibration.size, (int(astray.sum()), 2))
    return Matches(*seen, np.arange(count) % 5, 5), rectifier


def findings_of(calibration, rng, **options):
    matches, rectifier = true_matches(calibration, rng, **options)
    fit = fit_rig(matches, rectifier.K, calibration.size)
    found = {f.name: f for f in rig_findings(matches, fit, rectifier)}
    return found, {p.name: p for p in parts_of(fit, rectifier, 30.0)}


@pytest.mark.parametrize("seed", range(5))
def test_a_right_calibration_fits_also_among_wrong_matches(seed):
    found, parts = findings_of(RIG, np.random.default_rng(seed), wrong=0.25)
    assert {f.state for f in found.values()} <= {"fits", "unclear"}
    assert found["rows"].state == found["order"].state == found["pattern"].state == "fits"
    for part in parts.values():
        assert abs(part.value) < 4 * part.sigma


@pytest.mark.parametrize("deg", [2.0, -2.0, 0.5])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turned_camera_is_named_by_axis_and_angle(axis, deg):
    found, parts = findings_of(turned(axis, deg), np.random.default_rng(axis), wrong=0.1)
    named = "unclear" if axis == 1 and abs(deg) < 1 else "off"  # a lens may do that as well
    assert named in (found["rows"].state, found["disparities"].state)
    name = "xyz"[axis]
    assert parts[name].value == pytest.approx(-deg, abs=max(4 * parts[name].sigma, 0.02))
    others = [part for other, part in parts.items() if other != name]
    assert all(abs(part.value) < 4 * part.sigma for part in others)


def test_a_yaw_as_small_as_lenses_make_it_is_blamed_on_nobody():
    found, _ = findings_of(turned(1, 0.5), np.random.default_rng(0))
    assert found["rows"].state == "fits"
    assert found["disparities"].state == "unclear" and "p2" in found["disparities"].sentence
    found, _ = findings_of(turned(1, 1.5), np.random.default_rng(0))
    assert found["disparities"].state == "off"


def test_sigmas_are_as_large_as_errors_are():
    errors = []
    for seed in range(30):
        _, parts = findings_of(RIG, np.random.default_rng(seed), count=400)
        errors.append([part.value / part.sigma for part in parts.values()])
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 1.3)
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) > 0.2)


def test_a_narrow_view_of_a_flat_wall_cannot_tell_the_yaw_and_says_so():
    rng = np.random.default_rng(0)
    matches, rectifier = true_matches(RIG, rng, depth_m=(9.9, 10.1), count=4000)
    near = np.abs(matches.left - rectifier.K[:2, 2]).max(axis=1) < 130
    matches = Matches(matches.left[near], matches.right[near], matches.pair[near], 5)
    fit = fit_rig(matches, rectifier.K, RIG.size)
    found = {f.name: f for f in rig_findings(matches, fit, rectifier)}
    assert "off" not in {f.state for f in found.values()}
    assert "unclear" in {f.state for f in found.values()}


def test_swapped_images_are_named():
    matches, rectifier = true_matches(RIG, np.random.default_rng(0))
    swapped = Matches(matches.right, matches.left, matches.pair, matches.count)
    fit = fit_rig(swapped, rectifier.K, RIG.size)
    (finding, *_) = rig_findings(swapped, fit, rectifier)
    assert finding.state == "off"
    assert "left and right are swapped" in finding.sentence


def test_another_focal_length_and_another_distortion_are_told_apart():
    zoomed = replace(RIG, K_right=RIG.K_right * ((1.02, 1, 1), (1, 1.02, 1), (1, 1, 1)))
    found, parts = findings_of(zoomed, np.random.default_rng(0))
    assert found["rows"].state == "off"
    assert parts["focal"].value == pytest.approx(-2.0, abs=0.2)
    bent = replace(RIG, D_right=RIG.D_right + np.array((0.25, 0, 0, 0, 0)))
    found, _ = findings_of(bent, np.random.default_rng(0), count=4000)
    assert found["pattern"].state == "off"
    assert "distortion" in found["pattern"].sentence


def test_eyes_that_look_at_different_moments_are_named():
    matches, rectifier = true_matches(RIG, np.random.default_rng(0))
    shake = np.array((0.0, 4.0, -5.0, 2.0, -1.0))[matches.pair]
    moved = Matches(
        matches.left, matches.right + np.column_stack((0 * shake, shake)), matches.pair, 5
    )
    fit = fit_rig(moved, rectifier.K, RIG.size)
    found = {f.name: f for f in rig_findings(moved, fit, rectifier)}
    assert found["moments"].state == "off"
    assert "same moment" in found["moments"].sentence


@pytest.mark.parametrize(
    ("value", "sigma", "state"),
    [(0.1, 0.1, "fits"), (-2.0, 0.1, "off"), (0.6, 0.1, "unclear"), (0.1, 0.9, "unclear")],
)
def test_what_is_not_known_well_is_called_neither_right_nor_wrong(value, sigma, state):
    assert judged(value, sigma, 0.5) == state


@pytest.fixture(scope="module")
def pair():
    """A textured wall 8 m away with a chessboard 3.6 m before the cameras, squares of 0.1 m."""
    rng = np.random.default_rng(1)
    grey = np.clip(128 + 45 * noise(rng, 1000, 1300, 40, 5, 0.8), 0, 255).astype(np.uint8)
    wall = Quad(
        np.array((-13.0, -10, 7.0)), np.array((26.0, 0, 2.0)), np.array((0, 20.0, 0)), tiles(grey)
    )
    fields = np.indices((9, 12)).sum(0) % 2 == 0
    fields[[0, -1]] = fields[:, [0, -1]] = False
    board = np.where(fields, 30, 220).astype(np.uint8).repeat(30, 0).repeat(30, 1)
    turn = cv2.Rodrigues(np.array((0.2, -0.3, 0.1)))[0]
    panel = Quad(np.array((-0.3, -0.5, 3.9)), 1.2 * turn[:, 0], 0.9 * turn[:, 1], tiles(board))
    scene = Renderer([wall, panel], np.zeros((4, 8, 3)))
    eyes = (
        np.clip(np.rint(eye + rng.normal(0, 1.5, eye.shape)), 0, 255).astype(np.uint8)
        for eye in shot_through_lenses(scene, np.eye(4), RIG)
    )
    return ImagePair(*eyes, stamp_ns=0)


def tiles(grey):
    return grey[..., None].repeat(3, 2)


def longer_baseline(share):
    T = RIG.T_right_left.copy()
    T[:3, 3] *= 1 + share
    return replace(RIG, T_right_left=T)


def test_a_baseline_that_is_five_percent_off_is_named_by_a_chessboard(pair):
    known = KnownLength(0.1, board=(9, 6))
    assert check_rig([pair], RIG, known).findings[-1].state == "fits"
    for share, words in ((0.05, "too long"), (-0.05, "too short")):
        report = check_rig([pair], longer_baseline(share), known)
        assert report.verdict == "does not fit"
        assert f"the baseline is 5.0 % {words}" in report.sentence
        assert f"instead of {RIG.baseline_m:.2f}" in report.sentence
    without = check_rig([pair], longer_baseline(0.05))
    assert without.verdict != "does not fit"  # no row shows it


def test_a_baseline_that_is_five_percent_off_is_named_by_two_points(pair):
    rectifier = Rectifier(RIG)
    R = rectifier.R_rect_left
    ends = np.array(((-2.5, -1.0), (2.5, 1.2)))  # on the wall, whose depth is 8 + x / 13
    places = np.column_stack((ends, 8.0 + ends[:, 0] / 13)) @ R.T
    uv = (places @ rectifier.K.T)[:, :2] / places[:, 2:]
    known = KnownLength(float(np.linalg.norm(places[0] - places[1])), points=uv)
    assert check_rig([pair], RIG, known).findings[-1].state != "off"
    report = check_rig([pair], longer_baseline(0.05), known)
    assert report.findings[-1].value == pytest.approx(5.0, abs=1.0)
    assert report.findings[-1].state == "off"


def test_what_cannot_be_measured_is_refused_and_says_what_to_give(pair):
    with pytest.raises(CheckError, match="no pair of images"):
        check_rig([], RIG)
    with pytest.raises(CheckError, match="8x5 inner corners"):
        check_rig(
            [ImagePair(pair.left[:, ::-1].copy() * 0, pair.right, 0)], RIG, KnownLength(0.1, (8, 5))
        )
    outside = np.array(((1.0, 2.0), (9000.0, 3.0)))
    with pytest.raises(CheckError, match="not in the rectified left image"):
        check_rig([pair], RIG, KnownLength(0.1, points=outside))
    blank = np.full_like(pair.left, 128)
    report = check_rig([ImagePair(blank, blank, 0)], RIG)
    assert report.verdict == "cannot tell"
    assert "more texture" in report.sentence


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ((None, "9x6", None), "need --length"),
        ((0.1, None, None), "either --board or --points"),
        ((0.1, "9x6", "1,2,3,4"), "either"),
        ((-1.0, "9x6", None), "more than 0 m"),
        ((0.1, "9by6", None), "inner corners"),
        ((0.1, None, "1,2,3"), "u1,v1,u2,v2"),
        ((0.1, None, "1,2,1,2"), "two different"),
    ],
)
def test_an_impossible_length_is_refused(given, says):
    with pytest.raises(CheckError, match=says):
        known_length(*given)


def test_the_command_ends_with_zero_one_or_two(pair, tmp_path):
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        cv2.imwrite(str(tmp_path / side / "0.png"), getattr(pair, side))
    (tmp_path / "stereo.json").write_text(json.dumps(content_of(RIG)))
    wrong = tmp_path / "wrong.json"
    wrong.write_text(json.dumps(content_of(turned(0, 2.0))))
    picture = tmp_path / "rectified.png"

    def run(*options):
        command = [sys.executable, "-P", "-m", "fleetpose.robot_agent", "calibrate-check"]
        return subprocess.run(
            [*command, "--data", str(tmp_path), *options],
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip

    known = ("--length", "0.1", "--board", "9x6")
    good = run(*known, "--save", str(picture), "--json")
    report = json.loads(good.stdout)
    assert good.returncode == (0 if report["verdict"] == "fits" else 1)
    assert report["verdict"] != "does not fit"
    assert cv2.imread(str(picture)).shape == (480, 1280, 3)
    np.testing.assert_allclose(report["T_right_left"], RIG.T_right_left, atol=0.02)
    bad = run("--calibration", str(wrong))
    assert bad.returncode == 1
    assert "about x (pitch)" in bad.stdout.splitlines()[-1]
    for options in (("--calibration", "nowhere.json"), ("--board", "9x6"), ("--data", "nowhere")):
        refused = run(*options)
        assert refused.returncode == 2
        assert len(refused.stderr.splitlines()) == 1
