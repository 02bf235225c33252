"""From samples to the session: what arrives is opened and checked, then told to the session."""

from collections.abc import Callable

from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.message_decoder import Arrived, opened, picture_in
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Alignment,
    CameraAnnouncement,
    FleetState,
    PairCorrespondences,
    Receipts,
    RobotPose,
    Selection,
    ServerStatus,
)
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.transport import Sample

MAX_ROBOTS = 20_000  # names may be anybody's invention


class Intake:
    """Opens samples in the order they came, and remembers the cameras that pictures must fit.

    Args:
        session: what is told.
        keys: the keys of the site.
    """

    def __init__(self, session: OperatorSession, keys: Keys) -> None:
        self._session = session
        self._keys = keys
        self._cameras: dict[str, CameraAnnouncement] = {}

    def open(self, sample: Sample) -> Arrived:
        """What a sample holds.

        Raises:
            FleetPoseError: it is damaged, or under a key where it has no business.
        """
        match self._keys.chunks(sample.key):
            case ["robot", robot, "image"]:
                content = self._readable(robot, lambda: self._picture(robot, sample))
            case _:
                content = opened(self._keys, sample)
        if isinstance(content, CameraAnnouncement):
            if content.robot not in self._cameras and len(self._cameras) >= MAX_ROBOTS:
                raise CodecError(f"cameras of more than {MAX_ROBOTS} robots")
            self._cameras[content.robot] = content
        return Arrived(sample.key, content)

    def tell(self, content: Message | Picture) -> None:
        """Tells the session what has been opened."""
        session = self._session
        match content:
            case FleetState():
                session.on_fleet(content)
            case ServerStatus():
                session.on_status(content)
            case RobotPose():
                session.on_pose(content)
            case Alignment():
                session.on_alignment(content)
            case PairCorrespondences():
                session.on_correspondences(content)
            case Receipts():
                session.on_receipts(content)
            case Selection():
                session.on_selection(content)
            case CameraAnnouncement():
                session.on_camera(content)
            case Picture():
                session.on_picture(content)

    def _readable(self, robot: str, make: Callable[[], Picture]) -> Picture:
        """A picture, or tells the operator why there is none."""
        try:
            return make()
        except (CodecError, PictureError) as error:
            self._session.on_unreadable(robot, str(error))
            raise

    def _picture(self, robot: str, sample: Sample) -> Picture:
        return picture_in(sample, robot, self._cameras.get(robot), self._session.clock())
