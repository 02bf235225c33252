"""A pose server without network: the server's own site, jobs and solver, all in this process."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fleetpose.evaluation.bench.pairs.worker import of_wide, widen
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.correspondences.records import BookState, Change
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.messages.builders import Stamp, robot_pose, why_not_located
from fleetpose.pose_server.scheduling import affine_retries
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done, Job
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import RobotPose, ViewName

if TYPE_CHECKING:
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult
    from fleetpose.pose_server.state.views import KeptView

SESSION = "0" * 12
Aligner = Callable[[Job], "PairResult"]


class _InMemory:
    """A recorder that keeps nothing beyond the run."""

    def load(self) -> BookState:
        return BookState()

    def record(self, change: Change) -> None:
        pass


class OfflineServer:
    """The server of a fleet; of a still one each robot has sent one view.

    Time stands still while jobs are done one by one, so that nobody grows old by them.

    Args:
        wires: what the robots sent, by index of their views; what they would send of these when
            asked lies beside.
        align: does a job, as a worker would.

    Attributes:
        names: of the robots, by index.
        views: index of the view, by robot.
        jobs: done so far.
    """

    def __init__(self, wires: Mapping[int, Path], align: Aligner = run_job) -> None:
        self.site = Site(correspondences=CorrespondenceStore(_InMemory()))
        self.names: dict[int, str] = {}
        self.settings = ServerSettings.model_validate({})
        self.jobs = 0
        self._align = align
        self._now_s = 0.0
        self._wires: dict[ViewName, Path] = {}
        for index, wire in wires.items():
            self.names[index] = self.receive(wire).robot
        self.views = {name: index for index, name in self.names.items()}

    def receive(self, wire: Path, now_s: float = 0.0) -> ViewName:
        """Takes what a robot sent, at a time; older views go as they do in a live server. Returns
        the view's name.
        """
        view = open_view(wire.read_bytes(), None, now_s)
        self._now_s = now_s
        self._wires[view.name] = wire
        if view.name.robot not in self.site.robots:
            pipeline.receive_token(self.site, view.name.robot, view.name.epoch, True)
        pipeline.receive_view(self.site, view)
        dropped = self.site.views.prune(now_s, self.site.held())
        for robot in self.site.robots.values():
            robot.track.forget({name for name in dropped if name.robot == robot.name})
        for name in dropped:
            self._wires.pop(name, None)
        return view.name

    def settle(self, most_jobs: int) -> bool:
        """Aligns and solves by the server's own order of work until nothing is left to align;
        whether that came to pass within so many jobs.
        """
        self.solve()
        last = self.jobs + most_jobs
        while self.jobs < last:
            job = self._next_job()
            if job is None:
                return True
            self._do(job)
            self._answer_for_wide_sets()
            self.solve()
        return False

    def view(self, robot: str) -> ViewName:
        """The view of a robot."""
        (keyframe,) = self.site.robots[robot].track.keyframes
        return keyframe

    def kept(self, robot: str) -> "KeptView":
        """What the server keeps of a robot's view."""
        return self.site.views[self.view(robot)]

    @property
    def components(self) -> list[set[str]]:
        """Names of the robots that are joined."""
        assert self.site.solution is not None
        return [{v.robot for v in views} for views in self.site.solution.components.values()]

    def poses(self) -> dict[str, RobotPose]:
        """What the server publishes of each robot."""
        stamp = Stamp(SESSION, 0.0, 0)
        poses: dict[str, RobotPose] = {}
        for name, robot in self.site.robots.items():
            found = robot_pose(self.site, robot, self.settings, stamp)
            if found is not None:
                robot.publish(*found)
                poses[name] = found[0]
        return poses

    def why_not(self, robot: str) -> str:
        """Why a robot is not located, of the poses asked for last; empty if it is."""
        return why_not_located(self.site, self.site.robots[robot], self.settings, 0.0)

    def located_cameras(self) -> dict[str, Floats]:
        """T_fleet_camera (4, 4) of the robots that are located."""
        return {
            name: pose.T_fleet_robot @ self.kept(name).camera.T_robot_camera
            for name, pose in self.poses().items()
            if pose.located
        }

    def solve(self) -> None:
        """Solves the fleet, and judges what depends on that."""
        if self.site.solution is None:
            self.site.want_solution()
        while self.site.dirty:  # choosing an anchor makes it dirty once more
            pipeline.solve(self.site, self._now_s)
        pipeline.note_components(self.site)
        pipeline.judge_correspondences(self.site)
        monitor.judge_calibrations(self.site)

    def _next_job(self) -> Job | None:
        """What the server would do next, if nobody clicked for a while."""
        while compare_some(self.site, self._now_s):
            pass
        return pipeline.urgent_job(self.site) or pipeline.next_job(
            self.site, self._now_s + pipeline.QUIET_S
        )

    def _do(self, job: Job) -> None:
        """A job that fails is filed as the server files it."""
        self.jobs += 1
        try:
            done = Done(job, self._align(job))
        except FleetPoseError as error:
            done = Done(job, None, str(error))
        pipeline.take_result(self.site, done, self._now_s)

    def _answer_for_wide_sets(self) -> None:
        for view in affine_retries.wanted(self.site):
            wire = self._wires[view]
            widen(wire)
            affine_retries.receive(self.site, view, of_wide(wire).read_bytes())
