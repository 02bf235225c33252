"""What is said of topics, of a bag or of a robot that runs: a line for each, those that make
a camera and why, what is missing, and the command.
"""

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.topics.mounting import Mounting
from fleetpose.robot_agent.cameras.topics.options import TopicOptions, UpSource
from fleetpose.robot_agent.cameras.topics.sensor import Sensor
from fleetpose.rosmsg.bag import Recorded, Topic
from fleetpose.rosmsg.roles import missing
from fleetpose.rosmsg.stamps import Pairing, header_ns


@dataclass
class Seen:
    """What was seen of a topic: when its messages were taken, and how much later received, ns."""

    stamps_ns: list[int] = field(default_factory=list)
    late_ns: list[int] = field(default_factory=list)

    def note_headed(self, message: Recorded) -> None:
        """Takes a message that begins with a header; of a damaged one when it was received.

        Raises:
            CodecError: it is damaged.
        """
        try:
            self.stamps_ns.append(stamp_ns := header_ns(message))
            self.late_ns.append(message.received_ns - stamp_ns)
        except FleetPoseError:
            self.stamps_ns.append(message.received_ns)
            raise

    @property
    def rate_hz(self) -> float | None:
        """None of fewer than two messages."""
        span_ns = max(self.stamps_ns, default=0) - min(self.stamps_ns, default=0)
        return 1e9 * (len(self.stamps_ns) - 1) / span_ns if span_ns > 0 else None

    @property
    def late_s(self) -> float:
        """By how much it was received later than its header says, as a rule."""
        return float(np.median(self.late_ns)) * 1e-9 if self.late_ns else 0.0


def table(
    topics: Sequence[Topic], seen: Mapping[str, Seen], note: Callable[[Topic], str]
) -> Iterator[str]:
    """A line for each topic, with what is to be noted of it."""
    wide = max((len(topic.name) for topic in topics), default=0)
    types = max((len(topic.type) for topic in topics), default=0)
    for topic in topics:
        rate_hz = seen[topic.name].rate_hz if topic.name in seen else None
        rate = "" if rate_hz is None else f"  {rate_hz:6.1f} Hz"
        line = f"  {topic.name:{wide}}  {topic.type:{types}}  {topic.count:6}{rate}{note(topic)}"
        yield line.rstrip()


def camera(sensor: Sensor, skew: str, calibrated: bool) -> Iterator[str]:
    """Which topics make a camera and why, and what it lacks."""
    roles = sensor.roles
    for role, topic in roles.names.items():
        if topic is not None:
            yield f"  {role:11} {topic} ({roles.why.get(role, 'found')})"
    yield f"  skew        {skew}"
    yield f"  tf          {chain(sensor.mounting)}"
    yield f"  up          {_up(sensor)}"
    for line in missing(roles, calibrated):
        yield f"  missing     {line}"


def skew_of(pairing: Pairing[Recorded], pairs: int) -> str:
    """How far apart both messages of a pair were taken."""
    if not pairs:
        return f"no two of its messages belong together, within {1e-6 * pairing.at_most_ns:g} ms"
    skews_ms = 1e-6 * np.array(pairing.skews_ns)
    return (
        f"{np.median(skews_ms):.1f} ms, at most {skews_ms.max():.1f}, of {pairs} pairs; "
        f"{pairing.dropped} without partner"
    )


def chain(where: Mounting) -> str:
    """The frames from the robot's body to its camera."""
    if where.why_not:
        return f"{where.why_not}; taken as at the robot's origin, looking ahead"
    return " -> ".join(where.chain) + (" (moves)" if where.moves else " (fixed)")


def command(run: str, options: TopicOptions, calibration: Path | None) -> str:
    """A command with what of the options is not as usual."""
    usual = type(options)()
    given = [
        f" --{one.name.replace('_', '-')} {shlex.quote(str(value))}"
        for one in fields(options)
        if (value := getattr(options, one.name)) != getattr(usual, one.name)
    ]
    if calibration is not None:
        given.append(f" --calibration {shlex.quote(str(calibration))}")
    return f"{run}{''.join(given)}"


def _up(sensor: Sensor) -> str:
    """What may tell where up is."""
    roles, base = sensor.roles, sensor.mounting.base
    sources: dict[UpSource, tuple[str | None, str]] = {
        "imu": (roles.imu, "its accelerometer at rest"),
        "odom": (roles.odometry if base else None, "its odometry"),
        "tf": (base if sensor.tf.top(base) != base else None, "the uppermost frame of tf"),
    }
    told = [what for kind, (there, what) in sources.items() if there and sensor.up.needs(kind)]
    return "by " + ", else ".join(told) if told else "nothing tells"
