"""`robot-agent topics`: what a bag or a robot has, which of its topics make a camera and why, and
what is missing: one screen.
"""

import re
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from fleetpose.robot_agent.cameras.topics.options import TopicOptions
from fleetpose.robot_agent.checking.told import Told
from fleetpose.robot_agent.checking.topics import bag, live

_ENDPOINT = re.compile(r"(tcp|tls|udp|quic|ws|unixsock-stream)/.+")


def report(
    source: str, options: TopicOptions, calibration: Path | None = None, domain: int = 0
) -> Iterator[str]:
    """The lines of the screen.

    Args:
        source: a bag, or the endpoint of a robot's router.
        options: which topics.
        calibration: in place of infos.
        domain: ROS_DOMAIN_ID, of a robot.

    Raises:
        DataFolderError: there is no bag, or it cannot be read.
        UnreachableError: no router is there.
    """
    given = asdict(options)
    with Told() as told:
        if is_endpoint(source):
            yield from live.report(source, RosOptions(**given, domain=domain), calibration)
        else:
            yield from bag.report(source, BagOptions(**given), calibration)
        for line in told.lines:
            yield f"  note        {line}"


def is_endpoint(source: str) -> bool:
    """Whether a source is a router's, not a bag."""
    return _ENDPOINT.fullmatch(source) is not None and not Path(source).exists()
