"""What clicks are worth: the hand, the paper's method, rings, and the fleet solved from them."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.bench.clicks.click_noise import (
    WRONG_PX,
    right_clicks,
    with_wrong,
    wrong_of,
)
from fleetpose.evaluation.bench.clicks.rows import named
from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.bench.clicks.worker import ClickedAnswer, Lifted, timed_icp
from fleetpose.evaluation.bench.pairs.report import POSE_FILE_COLUMNS
from fleetpose.evaluation.bench.pairs.worker import Answer
from fleetpose.evaluation.bench.ring.command import RingOptions, run
from fleetpose.evaluation.bench.ring.layout import along_path, rings_of
from fleetpose.evaluation.bench.ring.report import write_summaries
from fleetpose.evaluation.bench.ring.solving import connected, solve_ring
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.metrics.geometry import inverse, rigid, transform
from fleetpose.pose_server.geometry import icp
from fleetpose.pose_server.registration.paper import linear_start
from fleetpose.protocol.errors import DataFolderError
from tests.evaluation.makers import pose, rotation, write_posed_views, write_rgbd

SIZES = ((640, 480), (640, 480))


def anywhere(view, pixel):
    return True


def correspondences(count=60):
    rng = np.random.default_rng(3)
    return rng.uniform(60, 400, (count, 2)), rng.uniform(60, 400, (count, 2))


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def cloud():
    return np.random.default_rng(4).uniform((-1, -1, 3), (1, 1, 5), (800, 3))


def test_right_clicks_are_true_up_to_the_hand_and_fewer_are_the_first_ones():
    true = correspondences()
    clicks = right_clicks(true, 5, np.random.default_rng(0), SIZES, anywhere)
    assert len(clicks) == 5
    for one, uv in zip(clicks.pixels, true, strict=True):
        nearest = np.linalg.norm(one[:, None] - uv[None], axis=2).min(axis=1)
        assert (nearest < 8).all()
    assert np.array_equal(clicks.first(2).pixels[0], clicks.pixels[0][:2])


def test_a_click_that_the_server_refuses_is_made_elsewhere():
    def on_the_left(view, pixel):
        return True if pixel[0] < 230 else None

    clicks = right_clicks(correspondences(), 3, np.random.default_rng(0), SIZES, on_the_left)
    assert len(clicks) == 3
    assert max(pixels[:, 0].max() for pixels in clicks.pixels) < 230


@pytest.mark.parametrize("seed", range(5))
def test_wrong_clicks_are_50_px_off_in_one_image_and_within_it(seed):
    rng = np.random.default_rng(seed)
    right = right_clicks(correspondences(), 5, rng, SIZES, anywhere)
    clicks = with_wrong(right, 2, rng, SIZES, anywhere)
    assert clicks.wrong.sum() == 2
    moved = [
        np.linalg.norm(a - b, axis=1) for a, b in zip(clicks.pixels, right.pixels, strict=True)
    ]
    assert np.allclose(moved[0] + moved[1], np.where(clicks.wrong, WRONG_PX, 0.0))
    assert (np.minimum(*moved) == 0).all()
    for pixels, size in zip(clicks.pixels, SIZES, strict=True):
        assert ((pixels >= 0) & (pixels <= np.subtract(size, 1))).all()


def test_a_share_of_clicks_is_the_nearest_whole_number():
    assert [wrong_of(n, 0.2) for n in range(6)] == [0, 0, 0, 1, 1, 1]


def test_true_pixels_come_from_tracks_or_from_depth_at_the_true_pose(tmp_path):
    write_posed_views(tmp_path / "views", count=2)
    posed = open_recording(tmp_path / "views", "sparse_noisy")
    assert len(true_pixels(posed, *posed.usable)[0]) == 280
    T_world_cameras = write_rgbd(tmp_path / "walk", count=2)
    walk = open_recording(tmp_path / "walk")
    i, j = walk.usable
    uv_i, uv_j = true_pixels(walk, i, j)
    shift_px = i.K[0, 0] * T_world_cameras[1][0, 3] / 2.0  # the wall is 2 m away
    assert np.allclose(uv_i - uv_j, (shift_px, 0), atol=0.2)


def test_the_paper_starts_by_the_model_that_its_clicks_determine(cloud):
    T_i_j = rigid(rotation((0, 1, 0), 20.0), np.array([0.3, 0.0, -0.1]))
    moved = transform(T_i_j, cloud)
    models = [linear_start(moved[:n], cloud[:n]).model for n in range(6)]
    assert models == ["identity", "translation", "translation", "rigid", "affine", "affine"]
    for n in (3, 4, 5):
        assert np.allclose(linear_start(moved[:n], cloud[:n]).T_i_j, T_i_j, atol=1e-6)
    shift = linear_start(transform(pose(t=(0.1, 0.2, 0.3)), cloud[:2]), cloud[:2]).T_i_j
    assert np.allclose(shift, rigid(np.eye(3), np.array([0.1, 0.2, 0.3])))


@pytest.mark.parametrize("how", ["small_gicp", "point_to_point", "point_to_plane"])
def test_icp_from_identity_recovers_a_tiny_motion(cloud, how):
    T_i_j = rigid(rotation((0, 1, 0), 0.5), np.array([0.01, -0.005, 0.01]))
    moved = transform(T_i_j, cloud)
    if how == "small_gicp":
        found = icp.point_to_point(icp.plain_cloud(moved), icp.plain_cloud(cloud), np.eye(4), 0.2)
    elif not icp.has_open3d():
        pytest.skip("Open3D needs libraries of the system that are not here")
    else:
        found = icp.by_open3d(moved, cloud, np.eye(4), 0.2, how)
    assert np.allclose(found, T_i_j, atol=1e-3)


def test_rings_have_regular_angles_and_close_where_the_views_do(tmp_path):
    write_posed_views(tmp_path / "arc", count=4)
    by_separation = rings_of(open_recording(tmp_path / "arc", "sparse"))
    assert [rings[0].separation_deg for rings in by_separation] == [10, 20, 30]
    assert [len(rings[0].pairs) for rings in by_separation] == [3, 1, 1]
    write_posed_views(tmp_path / "ring", count=36, points=1000)
    closed = rings_of(open_recording(tmp_path / "ring", "sparse"))
    pairs = closed[3][0].pairs  # at 40 degrees
    assert len(pairs) == len(closed[3][0].views) == 9
    assert len({view.index for pair in pairs for view in pair}) == 9


def test_seventy_two_views_make_the_papers_rings_of_8_to_72_robots(tmp_path):
    write_posed_views(tmp_path / "ring", count=72, points=1500, step_deg=5.0)
    found = rings_of(open_recording(tmp_path / "ring", "sparse"))
    robots = {rings[0].separation_deg: len(rings[0].views) for rings in found}
    assert {5: 72, 10: 36, 15: 24, 20: 18, 30: 12, 45: 8}.items() <= robots.items()
    closed = [rings[0] for rings in found if 360 % rings[0].separation_deg == 0]
    assert all(len(ring.pairs) == len(ring.views) for ring in closed)


def test_stereo_partners_are_no_neighbours(tmp_path):
    write_posed_views(tmp_path / "arc", count=4)
    ((ring,), *_) = rings_of(open_recording(tmp_path / "arc", "stereo_pair_sparse"))
    assert [(i.index, j.index) for i, j in ring.pairs] == [(1, 2)]


def test_views_without_ring_angles_are_put_in_order_along_the_path(tmp_path):
    write_posed_views(tmp_path / "set", count=5)
    cameras = json.loads((tmp_path / "set" / "cameras.json").read_text())
    for camera in cameras["cameras"]:
        del camera["ring_angle_deg"]
    (tmp_path / "set" / "cameras.json").write_text(json.dumps(cameras))
    recording = open_recording(tmp_path / "set", "sparse")
    mixed = [recording.usable[k] for k in (3, 0, 4, 1, 2)]
    order = [view.index for view in along_path(mixed)]
    assert order in ([0, 1, 2, 3, 4], [4, 3, 2, 1, 0])
    assert rings_of(recording)[0][0].separation_deg == pytest.approx(10.0)


def test_a_walk_is_no_ring(tmp_path):
    write_rgbd(tmp_path / "walk", count=3)
    with pytest.raises(DataFolderError, match="persist"):
        rings_of(open_recording(tmp_path / "walk"))


def test_pairs_left_out_leave_arcs():
    arcs = connected([(0, 1), (4, 5), (1, 2), (5, 3)])
    assert sorted(map(sorted, arcs)) == [[0, 1, 2], [3, 4, 5]]


def clicked(T_i_j, p_j, wrong=(), verdict="verified"):
    """An answer, and clicks at points p_j (N, 3) of which the `wrong` ones are half a metre off."""
    p_i = transform(T_i_j, p_j)
    mask = np.isin(np.arange(len(p_j)), wrong)
    p_i[mask] += (0.5, 0.0, 0.0)
    C = np.broadcast_to(np.eye(3) * 0.01**2, (len(p_j), 3, 3))
    answer = Answer(T_i_j, np.eye(6) * 1e-6, verdict, (), "features", 50, 10.0)
    return ClickedAnswer(answer, 0.0, Lifted(p_i, C), Lifted(p_j, C), mask)


def test_the_fleet_is_solved_from_pairs_and_marks_exactly_the_wrong_clicks(tmp_path, cloud):
    T_world_cameras = write_posed_views(tmp_path / "set", count=4)
    views = {view.index: view for view in open_recording(tmp_path / "set", "sparse").usable}
    answers = {
        (k, k + 1): clicked(inverse(T_world_cameras[k]) @ T_world_cameras[k + 1], cloud[:5], (k,))
        for k in range(3)
    }
    solved = solve_ring(views, answers, depth_m=2.0)
    assert solved.located == 1.0
    assert len(solved.errors_m) == 3  # all but the anchor
    assert max(solved.errors_m.values()) < 1e-3
    for k in range(3):
        assert named(answers[k, k + 1], solved.marked[k, k + 1])


def test_a_rejected_pair_without_clicks_leaves_its_robot_unlocated(tmp_path, cloud):
    write_posed_views(tmp_path / "set", count=4)
    views = {view.index: view for view in open_recording(tmp_path / "set", "sparse").usable}
    good, bad = clicked(pose(10.0), cloud[:0]), clicked(pose(10.0), cloud[:0], (), "rejected")
    solved = solve_ring(views, {(0, 1): good, (1, 2): bad}, depth_m=2.0)
    assert solved.located <= 0.5
    assert solved.marked[1, 2] is None


def test_a_robot_that_is_not_located_counts_where_its_neighbour_stands(tmp_path, cloud):
    T_world_cameras = write_posed_views(tmp_path / "set", count=4)
    views = {view.index: view for view in open_recording(tmp_path / "set", "sparse").usable}
    T = [inverse(T_world_cameras[k]) @ T_world_cameras[k + 1] for k in range(3)]
    answers = {
        (k, k + 1): clicked(T[k], cloud[:0], (), "verified" if k != 1 else "rejected")
        for k in range(3)
    }
    solved = solve_ring(views, answers, depth_m=2.0)
    as_by_paper = {**answers, (1, 2): clicked(np.eye(4), cloud[:0], (), "")}
    moved = solve_ring(views, as_by_paper, depth_m=2.0)
    assert len(solved.errors_m) == 3 and solved.located == pytest.approx(1 / 3)
    assert moved.located == 1.0
    for index, error_m in solved.errors_m.items():
        assert error_m == pytest.approx(moved.errors_m[index], abs=1e-6)
    assert max(solved.errors_m.values()) > 0.3  # 10 degrees of a ring of 2 m


def test_all_icp_counts_whichever_step_asks_for_it(cloud):
    from fleetpose.pose_server.geometry.icp import dense_cloud
    from fleetpose.pose_server.registration import refinement, surfaces

    users = [
        path.name
        for path in (Path(refinement.__file__).parents[1]).rglob("*.py")
        if re.search(r"import .*\bgicp\b|small_gicp\.align\b", path.read_text())
    ]
    # it is timed where these two call it
    assert sorted(users) == ["icp.py", "refinement.py", "surfaces.py"]
    one = dense_cloud(cloud, 0.1)
    for module in (refinement, surfaces):
        icp = module.gicp
        with timed_icp() as spent:
            module.gicp(one, one, np.eye(4), 0.1)
            once_ms = spent.ms
            module.gicp(one, one, np.eye(4), 0.1)
        assert 0.0 < once_ms < spent.ms
        assert module.gicp is icp


def ring(clicks, median_m, success=0.9, mean_m=1.0):
    return {
        "separation_deg": 10.0,
        "clicks": clicks,
        "robots": 36,
        "position_error_m": mean_m,
        "position_error_median_m": median_m,
        "success": success,
        "icp_ms": 1.0,
        "align_ms": 2.0,
    }


@pytest.mark.parametrize(
    ("median_m", "success", "mean_m", "met", "met_by_mean"),
    [
        (0.1, 0.9, 1.0, 1, 1),
        (0.1019, 0.9, 1.0, 1, 1),  # by less than 0.1 % of the depth
        (0.1021, 0.9, 1.0, 0, 1),
        (0.1, 0.8, 1.0, 0, 0),
        (None, 0.9, None, 0, 0),
        (0.1, 0.9, 1.001, 1, 0),  # the few that are lost are further off, the others are not
        (0.05, 1.0, 0.5, 1, 1),
    ],
)
def test_a_separation_is_met_if_nothing_is_worse_than_the_papers_three_clicks(
    tmp_path, median_m, success, mean_m, met, met_by_mean
):
    paper = {"recipe": "paper", "rings": [ring(0, 9.0, 0.0), ring(3, 0.1)]}
    none = ring(0, median_m, success, mean_m)
    full = {"recipe": "full", "median_depth_m": 2.0, "rings": [none, ring(3, 0.0, 1.0)]}
    (tmp_path / "paper").mkdir()
    (tmp_path / "full").mkdir()
    written = write_summaries(tmp_path, {"paper": paper, "full": full})
    assert (written["separations"], written["separations_met"]) == (1, met)
    assert written["separations_met_by_mean"] == met_by_mean


def test_ring_writes_the_columns_that_were_agreed_on(tmp_path):
    write_posed_views(tmp_path / "set", count=4)
    options = RingOptions(
        tmp_path / "set",
        "sparse",
        recipe="paper",
        clicks=(0, 3),
        wrong_share=0.34,
        draws=2,
        workers=1,
    )
    summary = run(options, tmp_path / "out")
    ring, poses = read(tmp_path / "out" / "ring.csv"), read(tmp_path / "out" / "poses.csv")
    agreed = ["separation_deg", "clicks", "robots", "pairs", "position_error_m", "success",
              "icp_ms", "align_ms"]  # fmt: skip
    assert list(ring[0])[: len(agreed)] == agreed
    assert list(poses[0]) == [*POSE_FILE_COLUMNS, "clicks", "draw"]
    assert len(poses) == 5 * (1 + 2)  # with no click one draw is enough
    assert summary["wrong_clicks"]["alignments"] == 10
    asked = {one["says"]: one["holds"] for one in summary["statements"]}
    assert len(asked) == 3 and asked["more clicks change it only slightly"] is None
    for name in ("summary.json", "fig9.png", "fig10.png"):
        assert (tmp_path / "out" / name).exists()


def test_a_ring_is_drawn_by_the_full_recipe_also_where_it_joins_nobody(tmp_path):
    write_posed_views(tmp_path / "set", count=3)
    options = RingOptions(tmp_path / "set", "sparse_noisy", clicks=(0,), workers=1)
    run(options, tmp_path / "out")
    assert (tmp_path / "out" / "fleet3d.png").read_bytes().startswith(b"\x89PNG")
