"""Robots that walk along recorded sequences, in step, and the server that follows them: offline, by
its own jobs in its own order, so that a run tells the same each time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.offline.server import OfflineServer
from fleetpose.evaluation.bench.published.sequences import RecordedSequence
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.report.output import progress_bar
from fleetpose.pose_server.persistence.placed import placed_views
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.codec import pack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import ViewName
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.robot_agent.features.packing import view_of
from fleetpose.robot_agent.recent_views import kept_view

EPOCH = "0" * 12
STEP_S = 1.0  # of the server's clock between two views of a robot
_JOBS_PER_ROBOT = 12  # in a step: more than a view asks for unless pairs go round in circles

_JOBS_AT_END_PER_ROBOT = 200


@dataclass(frozen=True, eq=False)
class Estimate:
    """Where the fleet puts one frame of a robot.

    Attributes:
        shot: its number in the robot's sequence.
        component: in whose frame.
        T_fleet_camera: (4, 4).
    """

    robot: str
    shot: int
    component: str
    T_fleet_camera: Floats


@dataclass(frozen=True)
class Played:
    """What became of a run.

    Attributes:
        anchors: name of the fleet's own component, empty where nobody is there.
        refused: views in which the server found nothing to use.
        lost: of each robot that had been joined, how many of its later views hang on nothing that
            the fleet's origin is joined to. Who was never joined has lost nothing.
    """

    estimates: tuple[Estimate, ...]
    anchors: str
    keyframes: int
    jobs: int
    refused: int
    lost: dict[str, int] = field(default_factory=dict)


def play(robots: Sequence[RecordedSequence], scratch: Path) -> Played:
    """Lets all robots walk to their ends, and tells what became of them: see `walked`."""
    return played_of(*walked(robots, scratch))


def walked(
    robots: Sequence[RecordedSequence], scratch: Path
) -> tuple[OfflineServer, int, dict[str, int]]:
    """Lets all robots walk to their ends; the server that followed them, how many views it could
    not use, and what each lost.

    Args:
        scratch: an empty folder for what robots get and send.

    Raises:
        FleetPoseError: a camera cannot be read.
    """
    server, refused, lost = OfflineServer({}), 0, dict[str, int]()
    walks = [robot.frames(scratch / "robots" / robot.name) for robot in robots]
    wires = scratch / "wires"
    wires.mkdir(parents=True)
    with progress_bar() as bar:
        task = bar.add_task("steps", total=max(len(robot.shots) for robot in robots))
        for step, frames in enumerate(zip_longest(*walks)):
            for robot, frame in zip(robots, frames, strict=True):
                if frame is not None and not _sent(server, robot, step, frame, wires):
                    refused += 1
            server.settle(_JOBS_PER_ROBOT * len(robots))
            _note_lost(server, step, lost)
            bar.advance(task)
        server.settle(_JOBS_AT_END_PER_ROBOT * len(robots))  # places seen long ago, by another one
    return server, refused, lost


def _sent(
    server: OfflineServer, robot: RecordedSequence, step: int, frame: Frame, wires: Path
) -> bool:
    """Does an agent's work for a frame and hands it over; whether the server could use it."""
    name = ViewName(robot=robot.name, epoch=EPOCH, seq=step)
    view = view_of(name, frame, salient_of(frame))
    wire = wires / f"{robot.name}_{step}.view"
    wire.write_bytes(pack(view))
    wire.with_suffix(".kept").write_bytes(pack(kept_view(view, frame.image)))
    try:
        server.receive(wire, step * STEP_S)
    except CodecError:
        return False
    return True


def _note_lost(server: OfflineServer, step: int, lost: dict[str, int]) -> None:
    """Counts robots whose view of this step does not hang in the fleet; those that never did are
    not in `lost`.
    """
    site = server.site
    for name, robot in site.robots.items():
        if robot.newest is None or robot.newest.seq != step:
            continue
        placed = site.camera_pose(robot.newest)
        joined = placed is not None and placed[0] == site.gauge and _has_others(site, placed[0])
        if joined:
            lost.setdefault(name, 0)
        elif name in lost:
            lost[name] += 1


def _has_others(site: Site, root: ViewName) -> bool:
    assert site.solution is not None
    return len({view.robot for view in site.solution.components[root]}) > 1


def played_of(server: OfflineServer, refused: int, lost: dict[str, int]) -> Played:
    """What became of a run."""
    site = server.site
    estimates = tuple(
        Estimate(view.robot, view.seq, one.component, np.asarray(one.T_fleet_camera, np.float64))
        for view, one in placed_views(site).items()
    )
    anchors = "" if site.gauge is None else site.component_name(site.gauge)
    return Played(estimates, anchors, len(site.keyframes()), server.jobs, refused, lost)
