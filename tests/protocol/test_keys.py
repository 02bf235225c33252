"""Keys are what the other side expects, and names cannot break them."""

import re

import pytest

from fleetpose.protocol.errors import NameRefusedError
from fleetpose.protocol.keys import Keys, checked_name, new_epoch, ordered_pair

BAD_NAMES = ["", "R1", "r 1", "r/1", "r*", "r$", "r?", "r#", "ä", "r1\n", "@r1", "x" * 33]


def test_keys_of_a_robot():
    keys = Keys("demo")
    assert keys.camera("r7") == "fleet/demo/robot/r7/camera"
    assert keys.cloud("r7") == "fleet/demo/robot/r7/cloud"
    assert keys.image("r7") == "fleet/demo/robot/r7/image"
    assert keys.view("r7") == "fleet/demo/robot/r7/view"
    assert keys.odometry("r7") == "fleet/demo/robot/r7/odometry"
    assert keys.robot_alive("r7", "0a") == "fleet/demo/robot/r7/alive/0a"


def test_keys_of_the_server():
    keys = Keys("demo")
    assert keys.pose("r7") == "fleet/demo/pose/r7"
    assert keys.heard("r7") == "fleet/demo/heard/r7"
    assert keys.denials("a") == "fleet/demo/router/a/denials"
    assert keys.poses == "fleet/demo/pose/**"
    assert keys.relative == "fleet/demo/server/relative"
    assert keys.status == "fleet/demo/server/status"
    assert keys.server_alive("0a") == "fleet/demo/server/alive/0a"
    assert keys.state == "fleet/demo/fleet/state"
    assert keys.alignment("a", "b") == "fleet/demo/pair/a/b/alignment"
    assert keys.correspondences("a", "b") == "fleet/demo/pair/a/b/correspondences"


def test_keys_of_an_operator():
    keys = Keys("demo")
    assert keys.receipts("eva") == "fleet/demo/operator/eva/receipts"
    assert keys.updates("eva") == "fleet/demo/operator/eva/correspondences"
    assert keys.selection("eva") == "fleet/demo/operator/eva/selection"


@pytest.mark.parametrize("name", ["r1", "a", "robot-7_b", "0", "x" * 32])
def test_a_good_name_is_returned(name):
    assert checked_name(name) == name


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_name_that_would_break_a_key_is_refused(name):
    with pytest.raises(NameRefusedError, match="1 to 32"):
        checked_name(name)
    with pytest.raises(NameRefusedError):
        Keys(name)


def test_a_key_comes_apart_into_its_chunks():
    keys = Keys("yard")
    assert keys.chunks(keys.cloud("r7")) == ["robot", "r7", "cloud"]


@pytest.mark.parametrize(
    "key",
    [
        "",
        "fleet/yard",
        "fleet/other/robot/r7/cloud",
        "fleet/yard/robot//cloud",
        "fleet/yard/a/",
        "x/yard/a",
    ],
)
def test_a_foreign_or_broken_key_is_refused(key):
    with pytest.raises(NameRefusedError):
        Keys("yard").chunks(key)


def test_epochs_are_random_and_fit_the_messages():
    epochs = {new_epoch() for _ in range(50)}
    assert len(epochs) == 50
    assert all(re.fullmatch("[0-9a-f]{12}", epoch) for epoch in epochs)


def test_a_pair_has_one_order():
    assert ordered_pair("r2", "r1") == ordered_pair("r1", "r2") == ("r1", "r2")
