"""The wide set of salient points: more of them, in the right places, made when asked for."""

import cv2
import numpy as np
import pytest

from fleetpose.protocol.clouds import decode_salient
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.messages import KeptView, ViewName
from fleetpose.robot_agent.cameras.base import DepthImage, Frame
from fleetpose.robot_agent.features.affine_keypoints import DIRECTIONS_DEG, tilted, wide_view
from fleetpose.robot_agent.features.keypoints import detect, grey_of, salient_points
from fleetpose.robot_agent.features.packing import view_of
from fleetpose.robot_agent.recent_views import KeptViews, kept_view
from tests.robot_agent.test_salient import MODEL

EPOCH = "a" * 12


@pytest.fixture(scope="module")
def image():
    noise = np.random.default_rng(3).integers(0, 256, (240, 320, 3), np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3.0), None, 0, 255, cv2.NORM_MINMAX)


@pytest.fixture
def kept(image):
    frame = Frame(5, image, DepthImage(np.full((240, 320), 2.0, np.float32)), MODEL)
    usual = salient_points(image, frame.ranges, MODEL, 100)
    name = ViewName(robot="r1", epoch=EPOCH, seq=7)
    return kept_view(view_of(name, frame, usual), image)


def test_a_wide_set_has_more_points_with_depth_inside_the_image(kept):
    wide = wide_view(kept)
    points = decode_salient(wide.salient)
    assert len(points.uv) > 2 * kept.view.salient.count
    assert (points.uv >= 0).all() and (points.uv <= (319, 239)).all()
    assert np.allclose(points.inverse_depth, 0.5, atol=1e-3)
    assert wide.salient.extractor == kept.view.salient.extractor
    assert wide.model_copy(update={"salient": kept.view.salient}) == kept.view


@pytest.mark.parametrize("direction", DIRECTIONS_DEG)
def test_an_image_seen_from_the_side_has_the_points_of_the_tilted_set(image, direction):
    grey = grey_of(image)
    turn = np.radians(direction)
    along = np.array([np.cos(turn), -np.sin(turn)])
    squeeze = np.eye(2) - 0.5 * np.outer(along, along)  # to half along one direction
    centre = np.array([160.0, 120.0])
    A = np.column_stack((squeeze, centre - squeeze @ centre))
    seen = detect(np.asarray(cv2.warpAffine(grey, A, (320, 240)), np.uint8), 300)
    there = (seen.uv - A[:, 2]) @ np.linalg.inv(squeeze).T
    inside = ((there > 20) & (there < (300, 220))).all(axis=1)
    found = tilted(grey, direction, 2000)
    distance = np.linalg.norm(there[inside][:, None] - found.uv[None], axis=2).min(axis=1)
    assert inside.sum() > 20
    assert np.mean(distance < 3.0) > 0.6


def test_a_robot_answers_with_the_wide_set_and_makes_it_once(kept, monkeypatch):
    views = KeptViews(EPOCH)
    views.keep(kept)
    answer = views.answer({"seq": "7", "epoch": EPOCH, "salient": "wide"})
    wide = unpack(KeptView, answer.payload, answer.encoding)
    assert wide.view.name == kept.view.name and wide.jpeg is None
    assert wide.view.salient.count > kept.view.salient.count
    monkeypatch.setattr(
        "fleetpose.robot_agent.recent_views.wide_view", lambda kept: pytest.fail("made again")
    )
    assert views.answer({"seq": "7", "salient": "wide"}).payload == answer.payload


def test_what_is_not_kept_or_has_no_image_is_said(kept):
    views = KeptViews(EPOCH)
    assert "no view yet" in (views.answer({"salient": "wide"}).error or "")
    views.keep(kept.model_copy(update={"jpeg": None}))
    assert "has no image" in (views.answer({"salient": "wide"}).error or "")
    views = KeptViews(EPOCH)
    views.keep(kept.model_copy(update={"jpeg": b"no image"}))
    assert "damaged" in (views.answer({"salient": "wide"}).error or "")
