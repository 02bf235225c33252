"""What robots show of themselves: tokens of publishers, and names."""

import pytest

from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.settings import SettingsRefusedError
from fleetpose.robot_agent.settings import RobotSettings
from fleetpose.rosmsg.dialects.rmw_zenoh import (
    NO_HASH,
    Endpoint,
    endpoint_of,
    publisher_token,
    subscriber_token,
    type_hash,
)
from fleetpose.rosmsg.live.directory import LONGEST_TOKEN, Directory
from fleetpose.rosmsg.live.names import name_of

IMAGE = "sensor_msgs/msg/Image"


def token(topic="/r1/image", hash=NO_HASH, entity=1):
    return publisher_token(0, "abc", entity, topic, IMAGE, hash, False, 10)


def test_publishers_of_all_distributions_are_one_topic_under_one_key():
    for hash in (type_hash(IMAGE), NO_HASH):
        endpoint = endpoint_of(token(hash=hash))
        assert endpoint.key == "0/r1/image/sensor_msgs::msg::dds_::Image_/*"
        assert (endpoint.topic, endpoint.type, endpoint.kind) == ("/r1/image", IMAGE, "publisher")


def test_a_subscriber_shows_the_hash_of_its_publisher():
    for hash in (type_hash(IMAGE), NO_HASH):
        shown = endpoint_of(subscriber_token(0, "me", 7, endpoint_of(token(hash=hash))))
        assert (shown.topic, shown.kind, shown.hash) == ("/r1/image", "subscriber", hash)
    behind_dds = endpoint_of("@/abc/@ros2_lv/MP/r1§image/sensor_msgs§msg§Image/:::")
    assert behind_dds == Endpoint("/r1/image", IMAGE, "r1/image", "publisher")


def test_a_topic_is_there_as_long_as_one_of_its_publishers():
    directory = Directory()
    for entity in (1, 2):
        directory.note(token(entity=entity), True)
    directory.note(subscriber_token(0, "me", 3, endpoint_of(token())), True)
    directory.note(token(entity=1), False)
    assert list(directory.endpoints()) == ["/r1/image"]
    directory.note(token(entity=2), False)
    assert not directory.endpoints()


def test_tokens_are_bounded_in_number_and_length():
    directory = Directory(most=3)
    for entity in range(3):
        directory.note(token(entity=entity), True)
    directory.note(token(entity=0), True)
    with pytest.raises(CodecError, match="more than 3 publishers"):
        directory.note(token(entity=3), True)
    with pytest.raises(CodecError, match="characters"):
        Directory().note(token(topic="/" + LONGEST_TOKEN * "x"), True)


@pytest.mark.parametrize(
    ("namespace", "name"),
    [("/Alpha", "alpha"), ("/site/Alpha", "alpha"), ("r1/", "r1"), ("/Ünit 1", "nit_1"), ("/", "")],
)
def test_a_robot_is_called_as_its_innermost_namespace(namespace, name):
    assert name_of(namespace) == name


def test_a_name_that_is_given_goes_before_the_namespace():
    given = {"camera": "ros", "data": "tcp/127.0.0.1:1", "namespace": "/Alpha"}
    assert RobotSettings.load(None, given).name == "alpha"
    assert RobotSettings.load(None, given | {"name": "r9"}).name == "r9"
    with pytest.raises(SettingsRefusedError, match="name"):
        RobotSettings.load(None, given | {"namespace": ""})
