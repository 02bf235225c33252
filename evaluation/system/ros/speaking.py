"""How nodes of ROS 2 speak on zenoh: rmw_zenoh as of Jazzy and of Humble, and DDS behind
zenoh-bridge-ros2dds.
"""

import itertools
import time
from collections.abc import Callable
from typing import Any, Literal

import zenoh
from zenoh import ext

from fleetpose.protocol.transport import Link
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.dialects.rmw_zenoh import NO_HASH

Dialect = Literal["jazzy", "humble", "ros2dds"]
DIALECTS: tuple[Dialect, ...] = ("jazzy", "humble", "ros2dds")
Put = Callable[[bytes], None]

_DEPTH = 10
_DOMAIN = 0


class Node:
    """Publishes topics.

    Args:
        link: a session of the node's own.
        dialect: how it speaks.
    """

    def __init__(self, link: Link, dialect: Dialect) -> None:
        self._link, self._dialect = link, dialect
        self._entities = itertools.count(1)
        self._zid = str(link.session.zid())

    def advertise(self, topic: str, type: str, latched: bool = False) -> Put:
        """Shows a publisher of a topic; returns what puts a coded message."""
        if self._dialect == "ros2dds":
            inner = topic.strip("/").replace("/", "§")
            token = f"@/{self._zid}/@ros2_lv/MP/{inner}/{type.replace('/', '§')}/:::"
            publisher = self._publisher(topic.strip("/"), latched)
            self._link.token(token)
            return publisher.put
        hash = NO_HASH if self._dialect == "humble" else rmw_zenoh.type_hash(type)
        key = rmw_zenoh.topic_key(_DOMAIN, topic, type, hash)
        entity = next(self._entities)
        of = (_DOMAIN, self._zid, entity, topic, type, hash, latched, _DEPTH)
        token = rmw_zenoh.publisher_token(*of)
        publisher, numbers = self._publisher(key, latched), itertools.count(1)
        self._link.token(token)

        def put(payload: bytes) -> None:
            carried = rmw_zenoh.attachment(next(numbers), time.time_ns(), token)
            publisher.put(payload, attachment=carried)

        return put

    def _publisher(self, key: str, latched: bool) -> Any:
        """As drivers have it: what finds no room on the way is dropped."""
        drop = zenoh.CongestionControl.DROP
        if not latched:
            return self._link.session.declare_publisher(key, congestion_control=drop)
        return ext.declare_advanced_publisher(
            self._link.session,
            key,
            cache=ext.CacheConfig(max_samples=1),
            publisher_detection=True,
            congestion_control=drop,
        )
