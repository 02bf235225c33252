"""Help for the operator's hand: snapping, depths, labels, and where a point is to be expected."""

import cv2
import numpy as np
import pytest
from hmi_fakes import CAMERA, alignment, fleet, pose, view
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.hmi_client.assist import picking
from fleetpose.hmi_client.assist.pick_assist import PickAssist
from fleetpose.hmi_client.desk.hints import LETTERS, Hints, labels
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.clouds import encode_depth, encode_scattered
from fleetpose.protocol.messages import Salient, View

SALIENT = Salient(extractor="rootsift", count=0, descriptor_bytes=128, data=b"")
DEPTH_M = 4.0


def textured(seed=0, shift=0):
    """A (480, 640) wall of smoothed noise with a bright square whose corner is at (320, 240)."""
    noise = np.random.default_rng(seed).uniform(0, 255, (480, 760)).astype(np.float32)
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 20, 200, cv2.NORM_MINMAX)
    wall[240:300, 320 + 60 : 380 + 60] = 255
    return wall.astype(np.uint8)[:, 60 - shift : 700 - shift]


def cloud_view(robot, cloud):
    return View(name=view(robot), stamp_ns=0, camera=CAMERA, cloud=cloud, salient=SALIENT)


def dense(robot, hole=False):
    depth = np.full((480, 640), DEPTH_M)
    if hole:
        depth[100:200, 100:200] = np.nan
    return Depths.of(cloud_view(robot, encode_depth(depth)))


def jpeg(robot, image):
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
    return Picture(view(robot), encoded.tobytes(), 1, 0.0)


def shown(left, right):
    """A session with two pictures of r1 and r2, held still."""
    session = OperatorSession("anna", clock=lambda: 0.0)
    session.on_fleet(fleet(6))
    session.select("r1", "r2")
    session.on_picture(jpeg("r1", left)), session.on_picture(jpeg("r2", right))
    session.hold_still()
    return session


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_a_cursor_near_a_corner_snaps_to_within_a_pixel(du, dv):
    snapped = picking.snap_to_corner(textured(), (320 + du, 240 + dv))
    assert snapped is not None
    assert np.abs(np.subtract(snapped, (319.5, 239.5))).max() <= 1.0


def test_nothing_to_snap_to_is_none_also_at_the_edge():
    flat = np.full((480, 640), 90, np.uint8)
    for pixel in ((320, 240), (0, 0), (639, 479), (-3, 900)):
        assert picking.snap_to_corner(flat, pixel) is None


@given(st.integers(1, 5), st.floats(-50, 50), st.floats(-50, 50))
def test_points_clicked_so_far_carry_others_along(count, du, dv):
    source = [(10.0, 20.0), (300.0, 40.0), (150.0, 400.0), (600.0, 300.0), (50.0, 50.0)][:count]
    target = [(u + du, v + dv) for u, v in source]
    assert picking.mapped((200.0, 100.0), source, target) == pytest.approx((200 + du, 100 + dv))
    assert picking.mapped((200.0, 100.0), [], []) is None


def test_points_on_a_line_do_not_run_away():
    source = [(0.0, 0.0), (100.0, 0.0), (200.0, 0.0)]
    u, v = picking.mapped((100.0, 300.0), source, source)
    assert (u, v) == pytest.approx((100.0, 300.0))


def test_depths_know_where_a_click_can_be_lifted():
    depths = dense("r1", hole=True)
    assert not depths.scattered and depths.has((50, 50)) and not depths.has((150, 150))
    assert depths.has((101, 150))  # two cells from the edge of the hole
    assert depths.lift((150, 150)) is None
    assert depths.lift((320, 240)) == pytest.approx((0, 0, DEPTH_M), abs=0.01)


def test_scattered_depths_find_the_nearest_point():
    uv, z = np.array([[100.0, 100.0], [300.0, 200.0]]), np.array([2.0, 3.0])
    depths = Depths.of(cloud_view("r1", encode_scattered(uv, z, 0.001)))
    nearest = depths.nearest((305.0, 200.0))
    assert depths.scattered and nearest is not None
    assert nearest.pixel == pytest.approx((300, 200)) and nearest.distance_px == pytest.approx(5)
    assert depths.has((305, 200)) and not depths.has((310, 200))
    assert depths.within(300, 200, 10, 10) == [(300.0, 200.0)]


def test_a_view_without_depth_has_none_anywhere():
    depths = Depths.of(cloud_view("r1", encode_depth(np.full((480, 640), np.nan))))
    assert depths.nearest((320, 240)) is None and not depths.has((320, 240))


@given(st.integers(0, 400))
def test_no_label_begins_another(count):
    made = labels(count)
    assert len(set(made)) == count and all(set(label) <= set(LETTERS) for label in made)
    assert len({len(label) for label in made}) <= 1


def test_typing_a_label_chooses_its_place_and_other_letters_change_nothing():
    places = [(float(k), 0.0) for k in range(30)]
    hints = Hints.of(places)
    label = labels(30)[7]
    assert hints.type(label[0]).type(label[1]).chosen == places[7]
    assert hints.type("m") == hints  # 30 labels begin with a or s


def test_the_other_half_is_expected_where_the_poses_put_it():
    session = shown(textured(), textured())
    session.on_depths(dense("r1")), session.on_depths(dense("r2"))
    session.on_pose(pose("r1", 0.0, 0.0, n=9))
    session.on_pose(pose("r2", 0.4, 0.0, n=9))  # the camera frame of the fakes is the body's
    session.pick(0, (320.0, 240.0))
    expected = PickAssist(session).expected()
    assert expected is not None and expected.side == 1
    assert expected.pixel == pytest.approx((320 - 500 * 0.4 / DEPTH_M, 240), abs=1)


def test_without_depth_under_the_pick_a_line_is_told():
    session = shown(textured(), textured())
    session.on_depths(dense("r1", hole=True)), session.on_depths(dense("r2"))
    session.on_pose(pose("r1", 0.0, 0.0, n=9)), session.on_pose(pose("r2", 0.4, 0.0, n=9))
    session.pick(0, (150.0, 150.0))
    expected = PickAssist(session).expected()
    assert expected is not None and expected.segment is not None


def test_where_poses_do_not_tell_looks_do():
    session = shown(textured(), textured(shift=40))
    for robot, component in (("r1", "r1"), ("r2", "r2-0")):
        session.on_pose(pose(robot, 0.0, 0.0, n=9, component=component))
    session.on_alignment(alignment("r1", "r2"))  # rejected: it tells nothing
    session.pick(0, (320.0, 240.0))
    expected = PickAssist(session).expected()
    assert expected is not None and "alike" in expected.how
    assert expected.pixel == pytest.approx((360, 240), abs=6)


def test_places_have_depth_as_far_as_that_is_known():
    session = shown(textured(), textured())
    guide = PickAssist(session)
    before = guide.places(0, 20, 20, 200)
    session.on_depths(dense("r1", hole=True))
    after = guide.places(0, 20, 20, 200)
    in_hole = [(u, v) for u, v in before if 110 < u < 190 and 110 < v < 190]
    assert in_hole and not set(in_hole) & set(after) and after


def test_among_scattered_points_the_cursor_snaps_to_one_that_has_depth():
    session = shown(textured(), textured())
    uv, z = np.array([[100.0, 100.0], [300.0, 200.0]]), np.array([2.0, 3.0])
    session.on_depths(Depths.of(cloud_view("r1", encode_scattered(uv, z, 0.001))))
    assert PickAssist(session).snap(0, (290.0, 190.0)) == pytest.approx((300, 200))
    session = shown(np.full((480, 640), 90, np.uint8), textured())
    with pytest.raises(OperatorError, match="no corner within 6 px"):
        PickAssist(session).snap(0, (290.0, 190.0))
