"""What pages get in bytes is what the arrays hold; points come again only when robots go on."""

import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")
sys.path.insert(0, str(Path(__file__).parents[1]))

from hmi_fakes import CAMERA, fleet, pose, view, wait_for

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.matrix import QUANTITIES
from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.web import frames
from fleetpose.hmi_client.web.clouds import Clouds, points_in_robot
from fleetpose.hmi_client.web.outlook import Pictures, Thrift, compressed
from fleetpose.protocol.clouds import encode_scattered
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.messages import Salient, View

NAMES = [f"r{k}" for k in range(1, 7)]


def unpacked(frame: bytes, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(N, N) values and states of a matrix frame."""
    upper, count = np.triu_indices(n, 1), n * (n - 1) // 2
    values, states = np.full((n, n), np.nan), np.zeros((n, n), np.uint8)
    values[upper] = np.frombuffer(frame, "<f2", count, 8)
    states[upper] = np.frombuffer(frame, np.uint8, count, 8 + 2 * count)
    assert len(frame) == 8 + 3 * count
    return values, states


def test_a_slow_page_gets_images_of_the_same_size_in_fewer_bytes_until_it_is_quick_again():
    thrift = Thrift()
    assert thrift.quality == 100
    qualities = []
    for took_s in (1.0,) * 5 + (0.3,) + (0.05,) * 5:
        thrift.drawn(took_s)
        qualities.append(thrift.quality)
    assert qualities[3] == qualities[5] == min(qualities) and qualities[-1] == 100
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    _, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 92])
    picture = Picture(view("r1"), jpeg.tobytes(), 2, 0.0)
    less = compressed(picture, 20)
    assert len(less.jpeg) < len(picture.jpeg) and (less.view, less.scale) == (picture.view, 2)
    assert cv2.imdecode(np.frombuffer(less.jpeg, np.uint8), 1).shape == pixels.shape
    damaged = Picture(view("r1"), b"\xff\xd8abc", 2, 0.0)
    assert compressed(damaged, 20) is damaged


def test_what_a_page_was_sent_can_be_picked_in_however_much_was_shown_since():
    pictures, shown = Pictures(), {"r1": None, "r2": None}
    desk = cast(
        Desk,
        SimpleNamespace(
            picture=lambda side: shown[("r1", "r2")[side]],
            session=SimpleNamespace(pair=("r1", "r2")),
        ),
    )
    for seq in range(200):
        shown["r1"] = Picture(view("r1", seq), b"", 1, 0.0)
        assert pictures.follow(desk)
        if seq == 0:
            first = pictures.shown[0]
            assert first is not None
            pictures.keep(first)
    assert pictures.seen(first.id) == Picture(view("r1", 0), b"", 1, 0.0)
    with pytest.raises(OperatorError, match="has gone"):
        pictures.seen(first.id + 1)


def test_an_image_goes_through_untouched():
    frame = frames.image(1, 70_000, Picture(view("r1"), b"\xff\xd8abc", 2, 0.0))
    assert frames.HEADER.unpack(frame[:8]) == (1, 1, 2, 70_000)
    assert frame[8:] == b"\xff\xd8abc"


def test_the_matrix_holds_every_pair_once_with_its_state():
    frame = frames.matrix(fleet(6), NAMES, 0.045, "rms", [("r5", "r6")])
    assert frames.HEADER.unpack(frame[:8]) == (2, 0, 6, 0)
    values, states = unpacked(frame, 6)
    assert values[0, 1] == pytest.approx(0.01, rel=1e-3) and states[0, 1] == 2 | 1 << 2
    assert states[0, 2] == 2 | 4 << 2 | 128 and np.isnan(values[0, 2])  # rejected
    assert states[1, 3] == 2 | 2 << 2 | 128  # plausible, hidden by the threshold
    assert states[0, 3] == 1  # through others
    assert states[4, 5] & 64  # asked
    assert states[0, 5] == 0  # r6 has no pose


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_each_quantity_has_values_where_pairs_were_aligned(quantity):
    values, _ = unpacked(frames.matrix(fleet(6), NAMES, 1.0, quantity, []), 6)
    known = np.isfinite(values)
    assert known[0, 1] == (quantity not in ("regression", "grave"))
    assert not known[0, 5]


def test_poses_come_in_the_order_of_the_names_and_nan_where_unknown():
    known = {"r1": pose("r1", 1.0, 2.0, 0.5), "r3": pose("r3", 4.0, 5.0, component="r3")}
    frame = frames.poses(["r1", "r2", "r3"], known, "r1")
    rows = np.frombuffer(frame, "<f4", offset=8).reshape(3, 8)
    assert rows[0, :3] == pytest.approx([1.0, 2.0, 0.5])
    assert np.isnan(rows[1, :6]).all() and rows[1, 6] == 0
    assert (rows[0, 7], rows[2, 7]) == (0, 1)


def test_points_are_packed_to_a_part_of_their_reach():
    points = np.random.default_rng(0).uniform(-80, 80, (100, 3))
    packed = frames.points_of_cloud(points, np.full((100, 3), 7, np.uint8))
    (quantum,) = np.frombuffer(packed, "<f4", 1)
    back = np.frombuffer(packed, "<i2", 300, 4).reshape(100, 3) * quantum
    assert np.abs(back - points).max() <= 0.51 * quantum < 0.002
    assert packed[604:] == b"\x07" * 300


def view_with_points(name) -> View:
    rng = np.random.default_rng(name.seq)
    uv, z = rng.uniform((0, 0), (639, 479), (4000, 2)), rng.uniform(2, 9, 4000)
    salient = Salient(extractor="rootsift", count=0, descriptor_bytes=128, data=b"")
    cloud = encode_scattered(uv, z, 0.001)
    return View(name=name, stamp_ns=0, camera=CAMERA, cloud=cloud, salient=salient)


def test_points_are_asked_for_once_per_place_and_a_new_pose_moves_them():
    asked, changed = [], threading.Event()

    def fetch(name):
        if name.robot == "r3":
            raise UnreachableError("r3 is not there")
        asked.append(name)
        return view_with_points(name)

    session = OperatorSession("kim")
    session.on_fleet(fleet(4, 1))
    clouds = Clouds(session, fetch, changed.set)
    wait_for(lambda: set(clouds.known) == {"r1", "r2"} and clouds.is_new())
    first = clouds.known["r2"]
    assert len(points_in_robot(view_with_points(view("r2")))) >= 3000
    moved = pose("r2", *(first.T_fleet_robot[:2, 3] + (0.05, 0.0)), 0.35, n=5)
    session.on_pose(moved)
    wait_for(lambda: clouds.known["r2"].version == 2)
    assert clouds.known["r2"].points == first.points
    assert sorted(name.robot for name in asked) == ["r1", "r2"]
    session.on_pose(pose("r2", 9.0, 9.0, 0.35, n=6, view=view("r2", 8)))
    wait_for(lambda: clouds.known["r2"].keyframe == 2, 8.0)
    assert asked[-1] == view("r2", 8) and clouds.known["r2"].points != first.points
    clouds.pause(True)
    clouds.close()
