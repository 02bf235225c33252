"""What arrives from the server and the robots, opened and checked before anything is done with
it.
"""

from dataclasses import dataclass
from typing import TypeVar

from hmi_client.model import Picture
from protocol.base import Message
from protocol.codec import unpack
from protocol.errors import CodecError
from protocol.keys import Keys
from protocol.messages import (
    Alignment,
    CameraAnnouncement,
    FleetState,
    PairCorrespondences,
    Receipts,
    RobotPose,
    ServerStatus,
)
from protocol.transport import Sample

M = TypeVar("M", bound=Message)


@dataclass(frozen=True)
class Arrived:
    """Something good, and the key it came under."""

    key: str
    content: Message | Picture


def opened(keys: Keys, sample: Sample) -> Message:
    """The message in a sample, by its key.

    Raises:
        CodecError: it is none, or that of another robot, pair or operator than the key says.
        NameRefusedError: the key is none of the site's.
    """

    def read(kind: type[M]) -> M:
        return unpack(kind, sample.payload, sample.encoding)

    match keys.chunks(sample.key):
        case ["fleet", "state"]:
            return read(FleetState)
        case ["server", "status"]:
            return read(ServerStatus)
        case ["pose", robot]:
            pose = read(RobotPose)
            return _of(pose, pose.robot == robot)
        case ["pair", i, j, "alignment"]:
            alignment = read(Alignment)
            return _of(alignment, (alignment.view_i.robot, alignment.view_j.robot) == (i, j))
        case ["pair", i, j, "correspondences"]:
            known = read(PairCorrespondences)
            return _of(known, (known.i, known.j) == (i, j))
        case ["operator", operator, "receipts"]:
            receipts = read(Receipts)
            return _of(receipts, receipts.operator == operator)
        case ["robot", robot, "camera"]:
            announced = read(CameraAnnouncement)
            return _of(announced, announced.robot == robot)
        case _:
            raise CodecError("nothing is expected under this key")


def _of(message: Message, owned: bool) -> Message:
    if not owned:
        raise CodecError(f"{type(message).__name__} under a key that is not its own")
    return message
