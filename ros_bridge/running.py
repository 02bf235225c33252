"""Runs a bridge until SIGTERM or Ctrl-C, and closes what it opened."""

import signal
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import EndedError
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.transport import Link, SessionSettings, open_session
from fleetpose.ros_bridge.bridge import Bridge
from fleetpose.ros_bridge.settings import BridgeSettings
from fleetpose.ros_bridge.topics import Topics, Wanted
from fleetpose.ros_bridge.zenoh_topics import ZenohTopics

ByTopics = Callable[[Wanted, Drops], Topics]


def run_bridge(settings: BridgeSettings, topics: ByTopics | None = None) -> None:
    """Waits for the routers, then bridges.

    Args:
        topics: gives those of ROS 2; without, they are those on zenoh.
    """
    log_to_stderr()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with ExitStack() as opened:
        try:
            fleet = _link(settings.of_fleet(stop), opened)
            if topics is None:
                other = settings.of_ros(stop)
                ros = fleet if other is None else _link(other, opened)
                topics = partial(ZenohTopics, ros, settings.domain)
        except EndedError:
            return
        Bridge(settings, fleet, topics).run(stop)


def _link(settings: SessionSettings, opened: ExitStack) -> Link:
    link = Link(open_session(settings))
    opened.callback(link.close)
    return link
