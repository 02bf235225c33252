"""What arrives from the server and the robots, opened and checked before anything is done with
it.
"""

from dataclasses import dataclass
from typing import TypeVar

from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.jpeg import check_size, frame_of
from fleetpose.hmi_client.model.records import Picture
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Alignment,
    Camera,
    CameraAnnouncement,
    FleetState,
    ImageHeader,
    PairCorrespondences,
    Receipts,
    RobotPose,
    Selection,
    ServerStatus,
)
from fleetpose.protocol.messages.base import MAX_MESSAGE_BYTES, Message
from fleetpose.protocol.transport import ENCODING_JPEG, Sample

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
        case ["operator", operator, "selection"]:
            selection = read(Selection)
            return _of(selection, selection.operator == operator)
        case ["robot", robot, "camera"]:
            announced = read(CameraAnnouncement)
            return _of(announced, announced.robot == robot)
        case _:
            raise CodecError("nothing is expected under this key")


def picture_in(
    sample: Sample, robot: str, announced: CameraAnnouncement | None, now_s: float
) -> Picture:
    """The picture in a sample under a robot's image key; nothing is decoded yet.

    Args:
        sample: a JPEG with its header as attachment.
        robot: of the key.
        announced: the robot's camera, if it has been announced.
        now_s: the session's clock.

    Raises:
        PictureError, CodecError: it is no JPEG with a header, or not one of this robot and camera.
    """
    if sample.encoding != ENCODING_JPEG or sample.attachment is None:
        raise PictureError(f"no JPEG with its header, but '{sample.encoding[:80]}'")
    header = unpack(ImageHeader, sample.attachment)
    if header.view.robot != robot:
        raise PictureError(f"an image of '{header.view.robot}' under the key of another robot")
    known = announced is not None and announced.epoch == header.view.epoch
    camera = announced.camera if announced is not None and known else None
    return checked_picture(header, sample.payload, camera, now_s)


def checked_picture(
    header: ImageHeader, jpeg: bytes, camera: Camera | None, now_s: float
) -> Picture:
    """A picture whose size has been read and fits; nothing is decoded yet.

    Raises:
        PictureError: it is no JPEG, or not one of this camera.
    """
    if len(jpeg) > MAX_MESSAGE_BYTES:
        raise PictureError(f"a JPEG of {len(jpeg)} bytes")
    frame = frame_of(jpeg)
    check_size(frame.width, frame.height, header.scale, camera)
    return Picture(header.view, jpeg, header.scale, now_s)


def _of(message: Message, owned: bool) -> Message:
    if not owned:
        raise CodecError(f"{type(message).__name__} under a key that is not its own")
    return message
