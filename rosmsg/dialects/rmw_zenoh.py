"""How ROS 2 stands on zenoh's keys: by rmw_zenoh, and by zenoh-bridge-ros2dds.

Both show publishers and subscribers as liveliness tokens. rmw_zenoh's keys carry domain, type and
its hash, and each sample an attachment of 33 bytes, without which rmw_zenoh drops it; the bridge's
keys are the topics' names and its samples CDR alone.
"""

import re
import struct
from dataclasses import dataclass
from functools import cache
from typing import Literal

import xxhash
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

DDS_TOKENS = "@/*/@ros2_lv/MP/**"
NO_HASH = "TypeHashNotSupported"
"""What Humble has in the place of a type's hash: its nodes do not meet those with one."""
_TOKEN_PARTS = 13  # of rmw_zenoh's publishers and subscribers
_DDS_TOKEN_PARTS = 6
_TOPIC = re.compile(r"(/[^/*$?#\s\x00-\x1f]+)+")
"""Of these signs ROS allows few, and zenoh asks with the others for something else."""
_TYPE = re.compile(r"\w+/\w+/\w+")
_DEFAULT_DEPTH = 42  # of rmw_zenoh: not written out


@dataclass(frozen=True)
class Endpoint:
    """A publisher or subscriber of a topic, as its token shows it.

    Attributes:
        topic: with its namespace, e.g. `/r1/odom`.
        type: e.g. `nav_msgs/msg/Odometry`.
        key: what to subscribe to; whatever the type's hash is.
        kind: what it does with the topic.
        hash: of the type; empty behind the bridge to DDS.
        latched: whether whoever comes late gets the last sample.
    """

    topic: str
    type: str
    key: str
    kind: Literal["publisher", "subscriber"]
    hash: str = ""
    latched: bool = False


def tokens(domain: int) -> tuple[str, ...]:
    """The keys under which the topics of a domain show themselves."""
    return f"@ros2_lv/{domain}/**", DDS_TOKENS


def endpoint_of(token: str) -> Endpoint | None:
    """What a token says; None of one that is neither a publisher's nor a subscriber's, or says what
    cannot be.
    """
    parts = token.split("/")
    found = None
    if parts[0] == "@ros2_lv" and len(parts) == _TOKEN_PARTS:
        found = _of_rmw(parts)
    if parts[0] == "@" and len(parts) >= _DDS_TOKEN_PARTS and parts[2:4] == ["@ros2_lv", "MP"]:
        topic = parts[4].replace("§", "/")
        found = Endpoint(f"/{topic}", parts[5].replace("§", "/"), topic, "publisher")
    can_be = found is not None and _TOPIC.fullmatch(found.topic) and _TYPE.fullmatch(found.type)
    return found if can_be else None


def topic_key(domain: int, topic: str, type: str, hash: str = "*") -> str:
    """Where the samples of a topic are."""
    return f"{domain}/{topic.strip('/')}/{_dds_type(type)}/{hash}"


def publisher_token(
    domain: int, zid: str, entity: int, topic: str, type: str, hash: str, latched: bool, depth: int
) -> str:
    """The token by which nodes find a publisher of ours.

    Args:
        zid: of its session; entity: a number of its own within it; depth: samples kept.
    """
    kept = "" if depth == _DEFAULT_DEPTH else depth
    qos = f":{1 if latched else ''}:,{kept}:,:,:,,"
    return _token(domain, zid, entity, "MP", topic, type, hash, qos)


def subscriber_token(domain: int, zid: str, entity: int, endpoint: Endpoint) -> str:
    """The token by which nodes find a subscriber of ours: drivers that publish only what somebody
    subscribes to look for it.
    """
    of = (endpoint.topic, endpoint.type, endpoint.hash or NO_HASH)
    return _token(domain, zid, entity, "MS", *of, "2::,1:,:,:,,")


def _token(
    domain: int, zid: str, entity: int, kind: str, topic: str, type: str, hash: str, qos: str
) -> str:
    node = f"@ros2_lv/{domain}/{zid}/0/{entity}/{kind}/%/%/fleetpose"
    return f"{node}/{topic.replace('/', '%')}/{_dds_type(type)}/{hash}/{qos}"


def attachment(sequence: int, stamp_ns: int, token: str) -> bytes:
    """What a sample carries: its number, when it was sent, and who its publisher is."""
    digest = xxhash.xxh3_128(token.encode()).intdigest()
    low, high = digest & (2**64 - 1), digest >> 64
    return struct.pack("<qqBQQ", sequence, stamp_ns, 16, low, high)


def type_hash(type: str) -> str:
    """RIHS01 of a type, as distributions from Iron on compute it."""
    return types().hash_rihs01(type)


@cache
def types() -> Typestore:
    """The messages of ROS 2 as Jazzy has them; those that are sent here are the same before."""
    return get_typestore(Stores.ROS2_JAZZY)


def _of_rmw(parts: list[str]) -> Endpoint | None:
    _, domain, *_, topic, type, hash, qos = parts
    kinds: dict[str, Literal["publisher", "subscriber"]] = {"MP": "publisher", "MS": "subscriber"}
    kind, type = kinds.get(parts[5]), _ros_type(type)
    if kind is None or type is None or not domain.isdigit():
        return None
    name = topic.replace("%", "/")
    latched = qos.split(":")[1:2] == ["1"]
    return Endpoint(name, type, topic_key(int(domain), name, type), kind, hash, latched)


def _dds_type(type: str) -> str:
    package, kind, name = type.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def _ros_type(dds: str) -> str | None:
    parts = dds.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return None
    return "/".join((*parts[:2], parts[3][:-1]))
