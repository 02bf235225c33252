"""What a bag has: one pass over all of it, in which images are not decoded."""

import logging
import shlex
from collections.abc import Iterator
from pathlib import Path

from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.bag.recording import BagRecording
from fleetpose.robot_agent.checking.topics import lines
from fleetpose.robot_agent.checking.topics.lines import Seen
from fleetpose.rosmsg.bag import Bag
from fleetpose.rosmsg.roles import HEADED

_LATE_S = 1.0  # a recorder on the robot gets an image within a frame or two
_EVERY = 50  # of the messages that are not needed, one in so many is read to see whether it can be


def report(source: str, options: BagOptions, calibration: Path | None) -> Iterator[str]:
    """The lines of the screen.

    Raises:
        DataFolderError: there is no bag, or it cannot be read.
    """
    bag = Bag(source)
    try:
        seen = _seen(bag)
        yield from _table(source, bag, seen)
        yield from _camera(source, bag, options, calibration, seen)
    finally:
        bag.close()


def _seen(bag: Bag) -> dict[str, Seen]:
    seen = {topic.name: Seen() for topic in bag.topics}
    for message in bag.messages():
        topic = seen[message.topic]
        if message.kind.name in HEADED:
            try:
                topic.note_headed(message)
            except CodecError as error:
                logging.getLogger(__name__).warning("%s", error)
            continue
        if len(topic.stamps_ns) % _EVERY == 0:
            bag.read(message)  # what cannot be read is told
        topic.stamps_ns.append(message.received_ns)
    return seen


def _table(source: str, bag: Bag, seen: dict[str, Seen]) -> Iterator[str]:
    total = sum(topic.count for topic in bag.topics)
    first, last = bag.span_ns or (0, 0)
    yield f"{source}: {total} messages of {len(bag.topics)} topics in {1e-9 * (last - first):.1f} s"
    yield from lines.table(
        bag.topics, seen, lambda topic: "  cannot be read" if bag.unreadable[topic.type] else ""
    )


def _camera(
    source: str, bag: Bag, options: BagOptions, calibration: Path | None, seen: dict[str, Seen]
) -> Iterator[str]:
    try:
        recording = BagRecording(bag, options, calibration)
    except FleetPoseError as error:
        yield f"  missing     {error}"
        return
    pairs = sum(1 for _ in recording.moments())
    skew = lines.skew_of(recording.pairing, pairs)
    yield from lines.camera(recording.sensor, skew, calibration is not None)
    late_s = seen[recording.roles.image].late_s
    if abs(late_s) > _LATE_S:
        yield (
            f"  note        its images were recorded {late_s:.1f} s after they were taken, by "
            "their headers: if other robots' were not, the clocks differed (--stamps receive)"
        )
    run = f"robot-agent run --name r1 --camera bag --data {shlex.quote(source)}"
    yield f"  run it      {lines.command(run, options, calibration)}"
