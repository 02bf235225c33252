"""`robot-agent topics`: what a bag has, which of its topics make a camera and why, and what is
missing: one screen.
"""

import logging
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.bag.recording import BagRecording
from fleetpose.robot_agent.checking.told import Told
from fleetpose.rosmsg.bag import Bag
from fleetpose.rosmsg.roles import HEADED, missing
from fleetpose.rosmsg.stamps import header_ns

_LATE_S = 1.0  # a recorder on the robot gets an image within a frame or two
_EVERY = 50  # of the messages that are not needed, one in so many is read to see whether it can be


@dataclass
class Seen:
    """What was seen of a topic: when its messages were taken, and how much later recorded, ns."""

    stamps_ns: list[int] = field(default_factory=list)
    late_ns: list[int] = field(default_factory=list)

    @property
    def rate_hz(self) -> float | None:
        """None of fewer than two messages."""
        span_ns = max(self.stamps_ns, default=0) - min(self.stamps_ns, default=0)
        return 1e9 * (len(self.stamps_ns) - 1) / span_ns if span_ns > 0 else None

    @property
    def late_s(self) -> float:
        """By how much its recorder was later than its header says, as a rule."""
        return float(np.median(self.late_ns)) * 1e-9 if self.late_ns else 0.0


def report(source: str, options: BagOptions, calibration: Path | None = None) -> Iterator[str]:
    """The lines of the screen.

    Raises:
        DataFolderError: there is no bag, or it cannot be read.
    """
    with Told() as told:
        bag = Bag(source)
        try:
            seen = _seen(bag)
            yield from _table(source, bag, seen)
            yield from _camera(source, bag, options, calibration, seen)
        finally:
            bag.close()
        for line in told.lines:
            yield f"  note        {line}"


def _seen(bag: Bag) -> dict[str, Seen]:
    """One pass over the bag; images are not decoded."""
    seen = {topic.name: Seen() for topic in bag.topics}
    for message in bag.messages():
        topic = seen[message.topic]
        stamp_ns = message.received_ns
        if message.kind.name in HEADED:
            try:
                stamp_ns = header_ns(message)
                topic.late_ns.append(message.received_ns - stamp_ns)
            except CodecError as error:
                logging.getLogger(__name__).warning("%s", error)
        elif len(topic.stamps_ns) % _EVERY == 0:
            bag.read(message)  # what cannot be read is told
        topic.stamps_ns.append(stamp_ns)
    return seen


def _table(source: str, bag: Bag, seen: dict[str, Seen]) -> Iterator[str]:
    total = sum(topic.count for topic in bag.topics)
    first, last = bag.span_ns or (0, 0)
    yield f"{source}: {total} messages of {len(bag.topics)} topics in {1e-9 * (last - first):.1f} s"
    wide = max((len(topic.name) for topic in bag.topics), default=0)
    types = max((len(topic.type) for topic in bag.topics), default=0)
    for topic in bag.topics:
        rate_hz = seen[topic.name].rate_hz
        rate = "" if rate_hz is None else f"  {rate_hz:6.1f} Hz"
        unread = bag.unreadable[topic.type]
        note = "  cannot be read" if unread else ""
        line = f"  {topic.name:{wide}}  {topic.type:{types}}  {topic.count:6}{rate}{note}"
        yield line.rstrip()


def _camera(
    source: str, bag: Bag, options: BagOptions, calibration: Path | None, seen: dict[str, Seen]
) -> Iterator[str]:
    try:
        recording = BagRecording(bag, options, calibration)
    except FleetPoseError as error:
        yield f"  missing     {error}"
        return
    roles = recording.roles
    for role, topic in roles.names.items():
        if topic is not None:
            yield f"  {role:11} {topic} ({roles.why.get(role, 'found')})"
    yield f"  skew        {_skew(recording)}"
    yield f"  tf          {_chain(recording)}"
    for line in missing(roles, calibrated=calibration is not None):
        yield f"  missing     {line}"
    late_s = seen[roles.image].late_s
    if abs(late_s) > _LATE_S:
        yield (
            f"  note        its images were recorded {late_s:.1f} s after they were taken, by "
            "their headers: if other robots' were not, the clocks differed (--stamps receive)"
        )
    yield f"  run it      {_command(source, options, calibration)}"


def _skew(recording: BagRecording) -> str:
    pairs = sum(1 for _ in recording.moments())
    pairing = recording.pairing
    if not pairs:
        return f"no two of its messages belong together, within {1e-6 * pairing.at_most_ns:g} ms"
    skews_ms = 1e-6 * np.array(pairing.skews_ns)
    return (
        f"{np.median(skews_ms):.1f} ms, at most {skews_ms.max():.1f}, of {pairs} pairs; "
        f"{pairing.dropped} without partner"
    )


def _chain(recording: BagRecording) -> str:
    where = recording.mounting
    if where.why_not:
        return f"{where.why_not}; taken as at the robot's origin, looking ahead"
    return " -> ".join(where.chain) + (" (moves)" if where.moves else " (fixed)")


def _command(source: str, options: BagOptions, calibration: Path | None) -> str:
    usual = BagOptions()
    given = [
        f" --{one.name.replace('_', '-')} {shlex.quote(str(value))}"
        for one in fields(BagOptions)
        if (value := getattr(options, one.name)) != getattr(usual, one.name)
    ]
    if calibration is not None:
        given.append(f" --calibration {shlex.quote(str(calibration))}")
    data = shlex.quote(source)
    return f"robot-agent run --name r1 --camera bag --data {data}{''.join(given)}"
