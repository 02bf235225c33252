"""Which pictures are offered for picking, which views the server keeps, and what is no picture."""

import struct
import tracemalloc

import cv2
import numpy as np
import pytest
from hmi_fakes import CAMERA, fleet, view

from fleetpose.hmi_client.errors import OperatorError, PictureError
from fleetpose.hmi_client.model.image_buffer import MAX_WAITING
from fleetpose.hmi_client.model.jpeg import MAX_PIXELS, check_size, frame_of
from fleetpose.hmi_client.model.picture_decoder import decoded
from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession

A, B = (10.0, 20.0), (30.0, 40.0)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    s = OperatorSession("anna", clock=clock)
    s.on_fleet(fleet(6))
    s.select("r1", "r2")
    return s


def show(session, robot, seq=7, **name):
    shown = view(robot, seq).model_copy(update=name)
    session.on_picture(Picture(shown, b"jpeg", 1, session.clock()))


def seqs(session):
    pictures = (session.picture(r) for r in ("r1", "r2"))
    return [p.view.seq if p else None for p in pictures]


def after(session, clock, seconds, n, **changes):
    """States at 2 Hz for a while; the number of the last."""
    for k in range(round(2 * seconds)):
        clock.now += 0.5
        session.on_fleet(fleet(6, n=n + k, **changes))
    return n + round(2 * seconds)


# ---- offered once the server has the view --------------------------------------------------------


def test_a_picture_is_shown_once_the_server_has_its_view_and_the_previous_one_until_then(session):
    show(session, "r1", 7), show(session, "r1", 9)
    assert seqs(session) == [7, None]
    before = session.revisions()
    session.on_fleet(fleet(6, n=2, seq=8))
    assert seqs(session) == [7, None]
    session.on_fleet(fleet(6, n=3, seq=9))
    assert seqs(session) == [9, None]
    assert session.wait_change(before, ("pictures",), 0.0)


def test_a_picture_that_waits_says_so(session):
    show(session, "r1", 8)
    assert "has not taken this view of r1 yet" in session.picture_notice("r1")
    with pytest.raises(OperatorError, match="has not taken this view"):
        session.pick(0, A)
    session.on_fleet(fleet(6, n=2, seq=8))
    assert session.picture_notice("r1") == ""
    session.pick(0, A)


def test_a_server_that_is_always_behind_does_not_starve_the_screen(session):
    """It never has the newest picture, but one of those before, however fast they come."""
    shown = []
    for k in range(40):
        show(session, "r1", 10 + k)
        if k % 5 == 4:
            session.on_fleet(fleet(6, n=2 + k, seq=10 + k - 12))
            shown.append(seqs(session)[0])
    assert shown[3:] == sorted(shown[3:]) and len(set(shown[3:])) >= 3
    assert all(newest - old <= 20 for old, newest in zip(shown[3:], range(29, 50, 5), strict=True))


def test_waiting_pictures_are_few(session):
    for k in range(1000):
        show(session, "r1", 10 + k)
    assert len(session._gallery._waiting["r1"]) == MAX_WAITING


def test_a_picture_of_another_life_of_the_robot_waits_for_that_life(session):
    show(session, "r1", 7)
    show(session, "r1", 0, epoch="b" * 12)
    assert session.picture("r1").view == view("r1", 7)
    robots = fleet(6).robots
    newest = view("r1", 0).model_copy(update={"epoch": "b" * 12})
    anew = (robots[0].model_copy(update={"newest_view": newest}), *robots[1:])
    session.on_fleet(fleet(6, n=2, robots=anew))
    assert session.picture("r1").view == newest


def test_an_older_picture_does_not_replace_a_newer_one(session):
    show(session, "r1", 7), show(session, "r1", 6)
    assert seqs(session) == [7, None]


def test_without_a_server_pictures_are_shown_but_not_picked_in(session, clock):
    show(session, "r1", 7), show(session, "r2", 7)
    clock.now += 10.0
    show(session, "r1", 12)
    assert seqs(session) == [12, 7]
    with pytest.raises(OperatorError, match="the server has not taken this view yet"):
        session.pick(0, A)
    session.pick(1, B)  # this one the server has had
    assert session.half is not None


def test_a_server_that_came_back_is_not_taken_to_have_what_was_taken_while_it_was_away(
    session, clock
):
    show(session, "r1", 7)
    clock.now += 10.0
    for seq in (8, 12, 30):
        show(session, "r1", seq)
    session.on_fleet(fleet(6, server_epoch="c" * 12, n=1, seq=7))  # it has restored its last view
    session.on_fleet(fleet(6, server_epoch="c" * 12, n=2, seq=13))
    assert seqs(session) == [None, None]  # nor that it has restored what the other one had
    session.on_fleet(fleet(6, server_epoch="c" * 12, n=3, seq=31))  # view 30 is asked of its robot
    assert seqs(session) == [30, None]


def test_pictures_frozen_without_a_server_can_be_picked_in_once_it_has_them(session, clock):
    clock.now += 10.0
    show(session, "r1", 12), show(session, "r2", 12)
    session.toggle_freeze()
    with pytest.raises(OperatorError, match="has not taken"):
        session.pick(0, A)
    session.on_fleet(fleet(6, n=2, seq=13))
    assert seqs(session) == [12, 12]
    session.pick(0, A)
    assert session.pick(1, B).update.view_i == view("r1", 12)


def test_the_pick_names_the_picture_that_was_before_the_eyes(session):
    show(session, "r1", 7), show(session, "r2", 7)
    seen = session.picture("r1")
    session.on_fleet(fleet(6, n=2, seq=9))
    show(session, "r1", 9)  # arrives between painting and the key
    session.pick(0, A, seen)
    assert session.selection().view_i == view("r1", 7)
    assert session.picture("r1").view == view("r1", 7)


def test_a_picture_that_changed_under_the_hand_is_not_picked_in(session):
    show(session, "r1", 7), show(session, "r2", 7)
    seen = session.picture("r2")
    session.on_fleet(fleet(6, n=2, seq=9))
    show(session, "r2", 9)
    session.pick(0, A)  # freezes the newer one of r2
    with pytest.raises(OperatorError, match="has just changed"):
        session.pick(1, B, seen)
    assert session.half is not None


# ---- kept by the server --------------------------------------------------------------------------


def frozen(session):
    show(session, "r1", 7), show(session, "r2", 7)
    session.pick(0, A)


def test_pinned_views_are_marked(session, clock):
    frozen(session)
    assert session.keeping("r1") == ""
    session.on_fleet(fleet(6, n=2, pinned=(view("r1"), view("r2"))))
    assert (session.keeping("r1"), session.keeping("r2")) == ("pinned", "pinned")
    after(session, clock, 10.0, 3, pinned=(view("r1"), view("r2")))
    assert session.keeping("r1") == "pinned" and not any("keep" in e for e in session.events)


def test_a_view_that_is_not_kept_after_three_seconds_is_told_once(session, clock):
    frozen(session)
    n = after(session, clock, 3.0, 2, pinned=(view("r1"),))
    assert session.keeping("r2") == ""
    n = after(session, clock, 5.0, n, pinned=(view("r1"),))
    assert (session.keeping("r1"), session.keeping("r2")) == ("pinned", "not kept")
    told = [event for event in session.events if "does not keep" in event]
    assert told == [
        "the server does not keep view 7 of r2 any more: thaw (f) and pick in a newer image"
    ]
    after(session, clock, 2.0, n, pinned=(view("r1"), view("r2")))
    assert session.keeping("r2") == "pinned"


def test_a_server_that_is_not_heard_is_not_blamed(session, clock):
    frozen(session)
    clock.now += 20.0
    session.on_fleet(fleet(6, n=2))
    assert session.keeping("r1") == ""
    after(session, clock, 2.5, 3)
    assert session.keeping("r1") == ""
    after(session, clock, 1.5, 8)
    assert session.keeping("r1") == "not kept"


def test_another_server_is_given_time_again(session, clock):
    frozen(session)
    n = after(session, clock, 2.5, 2, pinned=(view("r1"), view("r2")))
    n = after(session, clock, 2.5, n, server_epoch="f" * 12)
    assert session.keeping("r1") == ""
    after(session, clock, 2.5, n, server_epoch="f" * 12)
    assert session.keeping("r1") == "not kept"


def test_picks_in_a_view_that_is_not_kept_are_sent_all_the_same(session, clock):
    frozen(session)
    after(session, clock, 5.0, 2)
    ticket = session.pick(1, B)
    assert session.open_updates() == (ticket.update,)


def test_f_lets_go_of_a_view_that_is_not_kept(session, clock):
    frozen(session)
    after(session, clock, 5.0, 2, seq=9)
    show(session, "r1", 9)
    session.toggle_freeze()
    assert not session.frozen and session.half is None
    assert session.picture("r1").view == view("r1", 9)


# ---- pictures that are none ----------------------------------------------------------------------


def jpeg(width=64, height=48, grey=False, *options):
    image = np.full((height, width) if grey else (height, width, 3), 90, np.uint8)
    image[: height // 2] = 200
    return cv2.imencode(".jpg", image, options)[1].tobytes()


def claiming(width, height):
    """A JPEG whose header declares another size."""
    data = bytearray(jpeg())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


PNG = cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
HUGE_PNG = PNG[:16] + struct.pack(">II", 60000, 60000) + PNG[24:]

BAD = {
    "empty": (b"", "no JPEG"),
    "text": (b"hello" * 100, "no JPEG"),
    "png": (PNG, "no JPEG"),
    "huge png": (HUGE_PNG, "no JPEG"),
    "huge": (claiming(60000, 60000), "60000x60000 px are too many"),
    "no size": (claiming(0, 48), "is none"),
    "cut in its header": (jpeg()[:100], "cut off"),
    "cut in its pixels": (jpeg()[:-40], "cut off: the end is missing"),
    "only its ends": (b"\xff\xd8\xff\xd9", "cut off"),
    "scans": (jpeg()[:-2] + b"\xff\xda" * 300 + b"\xff\xd9", "too many scans"),
    "lossless": (jpeg().replace(b"\xff\xc0", b"\xff\xc3", 1), "baseline or progressive"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_picture_is_refused_before_anything_is_decoded(name, monkeypatch):
    data, reason = BAD[name]

    def decode(*_):
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)
    tracemalloc.start()
    try:
        with pytest.raises(PictureError, match=reason):
            decoded(Picture(view("r1"), data, 1, 0.0))
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_the_limit_lets_real_cameras_through():
    assert frame_of(claiming(7000, 5000)).width == 7000
    assert 7000 * 5000 < MAX_PIXELS < 60000 * 60000


@pytest.mark.parametrize("data", [jpeg(), jpeg(64, 48, True), jpeg(64, 48, False, 2, 1)])
def test_colour_grey_and_progressive_are_shown(data):
    image = decoded(Picture(view("r1"), data, 1, 0.0))
    assert image.shape == (48, 64, 3)
    assert abs(int(image[0, 0, 0]) - 200) < 5 and abs(int(image[-1, -1, 2]) - 90) < 5


def test_an_image_is_not_turned_by_its_exif_since_pixels_are_the_sensors():
    tiff = b"MM\x00\x2a\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00"
    exif = b"Exif\x00\x00" + tiff + b"\x00\x00\x00\x00"
    data = jpeg()
    turned = data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]
    assert cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR).shape[:2] == (64, 48)
    assert decoded(Picture(view("r1"), turned, 1, 0.0)).shape[:2] == (48, 64)


def test_damaged_pixels_raise_nothing_else(capfd):
    data = jpeg(640, 480)
    for seed in range(40):
        damaged = bytearray(data)
        rng = np.random.default_rng(seed)
        for at in rng.integers(2, len(data), 20):
            damaged[at] = rng.integers(0, 256)
        try:
            image = decoded(Picture(view("r1"), bytes(damaged), 1, 0.0))
        except PictureError:
            continue
        assert image.ndim == 3 and image.size <= 3 * MAX_PIXELS
    capfd.readouterr()  # the decoder complains


@pytest.mark.parametrize(
    ("size", "scale", "fits"),
    [
        ((640, 480), 1, True),
        ((320, 240), 2, True),
        ((214, 160), 3, True),  # 640 is no multiple of 3
        ((640, 480), 2, False),
        ((480, 640), 1, False),
        ((638, 480), 1, False),
    ],
)
def test_the_size_times_the_scale_must_be_the_cameras(size, scale, fits):
    if fits:
        check_size(*size, scale, CAMERA)
        return
    with pytest.raises(PictureError, match="do not fit the camera's 640x480"):
        check_size(*size, scale, CAMERA)


def test_a_size_of_no_camera_is_refused_before_the_camera_is_known():
    check_size(4000, 3000, 1, None)
    with pytest.raises(PictureError, match="of no camera"):
        check_size(4000, 3000, 16, None)
