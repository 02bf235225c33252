"""What a recording tells of the server that was recorded, and what that server had heard."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fleetpose.pose_server.correspondences.records import Progress, Session
from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    FleetState,
    OperatorUpdate,
    PairCorrespondences,
    RobotPose,
    ServerStatus,
    ViewName,
)
from fleetpose.protocol.recording.file import Record, Recording, RecordingError

USUAL_JOB_MS = 100.0  # of an alignment, where the recording does not tell


@dataclass
class Recorded:
    """What was told about a site beside what its server heard.

    Attributes:
        poses: the last that was told of each view.
        servers: lives of the server.
        anchor: the first.
        workers, job_ms: of the server: alignments at once, and how long one took (median).
        began: how far each operator's session had come before the recording began.
        next_id: the first correspondence that is not older than the recording.
        undecodable: messages of it that could not be read.
    """

    poses: dict[ViewName, RobotPose] = field(default_factory=dict)
    servers: set[str] = field(default_factory=set)
    anchor: str | None = None
    workers: int = 1
    job_ms: float = USUAL_JOB_MS
    began: dict[Session, Progress] = field(default_factory=dict)
    next_id: int = 0
    undecodable: int = 0

    @classmethod
    def of(cls, recording: Recording) -> "Recorded":
        """Reads a recording once."""
        told = cls()
        for record in recording:
            try:
                told._note(record)
            except FleetPoseError:
                told.undecodable += 1
        return told

    def _note(self, record: Record) -> None:
        sample = record.sample
        if record.way != "in":
            return
        if sample.encoding == encoding_of(RobotPose):
            pose = unpack(RobotPose, sample.payload)
            self.poses[pose.view] = pose
            self.servers.add(pose.server_epoch)
        elif sample.encoding == encoding_of(ServerStatus):
            status = unpack(ServerStatus, sample.payload)
            self.workers = max(status.workers, 1)
            self.job_ms = status.stage_ms.get("job", self.job_ms)
        elif sample.encoding == encoding_of(FleetState) and self.anchor is None:
            self.anchor = unpack(FleetState, sample.payload).anchor
        elif sample.encoding == encoding_of(PairCorrespondences) and not self.began:
            items = unpack(PairCorrespondences, sample.payload).items
            self.next_id = max([self.next_id, *(item.id + 1 for item in items)])
        elif sample.encoding == encoding_of(OperatorUpdate):
            update = unpack(OperatorUpdate, sample.payload)
            self.began.setdefault((update.operator, update.session), Progress(update.n - 1))


def site_recording(path: Path) -> Recording:
    """Opens the recording of a site.

    Raises:
        RecordingError: it cannot be read, or is none.
    """
    recording = Recording(path)
    if recording.operator:
        raise RecordingError(
            f"{path} is an operator's session, without the views of the robots: record the site "
            "with 'pose-server record'"
        )
    return recording


def heard(recording: Recording, keys: Keys) -> Iterator[Record]:
    """What the server had heard, in order of arrival: tokens, and what robots, operators and
    routers say.
    """
    said_by = tuple(f"{keys.root}/{who}/" for who in ("robot", "operator", "router"))
    for record in recording:
        if record.sample.key.startswith(said_by):
            yield record
