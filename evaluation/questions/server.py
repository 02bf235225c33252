"""A pose server of one drawn fleet, without network: the server's own site, jobs and solver, all in
this process.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from evaluation.geometry import Floats
from evaluation.interaction.worker import kept
from evaluation.pair_worker import of_wide
from pose_server import pipeline
from pose_server.correspondences.book import Book
from pose_server.correspondences.records import BookState, Change
from pose_server.pairs.engine import Done, Job, run_job
from pose_server.publish import Stamp, robot_pose
from pose_server.settings import ServerSettings
from pose_server.site import Site
from protocol.keys import ordered_pair
from protocol.messages import OperatorUpdate, Selection, ViewName

if TYPE_CHECKING:
    from pose_server.pairs.judging import PairResult
    from pose_server.views import KeptView

OPERATOR, SESSION = "op-simulated", "0" * 12
RobotPair = tuple[str, str]
LOOKED_S = 10.0  # that an operator takes to see that two images have nothing to click


class _InMemory:
    """A recorder that keeps nothing beyond the run."""

    def load(self) -> BookState:
        return BookState()

    def record(self, change: Change) -> None:
        pass


class FleetServer:
    """One still fleet: each robot has sent one view, and all pairs were aligned automatically.

    Args:
        wires: what the robots sent, by index of their views; the wide sets lie beside.
        results: automatic alignment of each pair of robots, by their names in order.

    Attributes:
        names: of the robots, by index.
        views: index of the view, by robot.
    """

    def __init__(
        self, wires: Mapping[int, Path], results: Mapping[RobotPair, "PairResult"]
    ) -> None:
        self.site = Site(book=Book(_InMemory()))
        self.names: dict[int, str] = {}
        self.settings = ServerSettings.model_validate({})
        self._now_s, self._sent = 0.0, 0
        for index, wire in wires.items():
            view = kept(wire)
            self.names[index] = view.name.robot
            pipeline.receive_token(self.site, view.name.robot, view.name.epoch, True)
            pipeline.receive_view(self.site, view)
            if of_wide(wire).exists():
                self.site.widening.sets[view.name] = of_wide(wire).read_bytes()
        self.views = {name: index for index, name in self.names.items()}
        for (a, b), result in results.items():
            i, j = self.view(a), self.view(b)
            job = Job("pair", self.site.encoded(i), self.site.encoded(j))
            pipeline.take_result(self.site, Done(job, result), 0.0)
        for record in self.site.pairs.values():
            record.untried.clear()
        self._solve()

    def view(self, robot: str) -> ViewName:
        """The view of a robot."""
        (keyframe,) = self.site.robots[robot].track.keyframes
        return keyframe

    @property
    def components(self) -> list[set[str]]:
        """Names of the robots that are joined."""
        assert self.site.solution is not None
        return [{v.robot for v in views} for views in self.site.solution.components.values()]

    def all_located(self) -> bool:
        """Whether every robot is located, by the server's own definition."""
        return len(self.located_cameras()) == len(self.views)

    def located_cameras(self) -> dict[str, Floats]:
        """T_fleet_camera (4, 4) of the robots that are located."""
        stamp = Stamp(SESSION, 0.0, 0)  # nobody grows old while clicks are counted
        poses = {
            name: robot_pose(self.site, robot, self.settings, stamp)
            for name, robot in self.site.robots.items()
        }
        return {
            name: pose.T_fleet_robot @ self.kept(name).camera.T_robot_camera
            for name, pose in poses.items()
            if pose is not None and pose.located
        }

    def is_verified(self, robot: str) -> bool:
        """Whether only verified alignments hang it on the anchor."""
        assert self.site.solution is not None
        return self.site.solution.nodes[self.view(robot)].verdict == "verified"

    def kept(self, robot: str) -> "KeptView":
        """What the server keeps of a robot's view."""
        return self.site.views[self.view(robot)]

    def visit(self, pair: RobotPair, clicks: Iterable[tuple[Floats, Floats]]) -> None:
        """The operator takes a pair on the screen, clicks the same points (2,) in both views, and
        goes on; the server does all that follows.
        """
        self._select(pair)
        for pixel_i, pixel_j in clicks:
            self._sent += 1
            update = OperatorUpdate(
                operator=OPERATOR,
                session=SESSION,
                n=self._sent,
                action="add",
                i=pair[0],
                j=pair[1],
                base_revision=0,
                view_i=self.view(pair[0]),
                view_j=self.view(pair[1]),
                pixel_i=np.asarray(pixel_i),
                pixel_j=np.asarray(pixel_j),
            )
            pipeline.receive_update(self.site, update)
        self._now_s += LOOKED_S
        self._select(None)
        while (job := self._next_job()) is not None:
            pipeline.take_result(self.site, Done(job, run_job(job)), self._now_s)
        self._solve()

    def _next_job(self) -> Job | None:
        return pipeline.urgent_job(self.site) or pipeline.next_job(self.site, self._now_s)

    def _select(self, pair: RobotPair | None) -> None:
        i, j = (None, None) if pair is None else pair
        views = [None if name is None else self.view(name) for name in (i, j)]
        selection = Selection(
            operator=OPERATOR, session=SESSION, i=i, j=j, view_i=views[0], view_j=views[1]
        )
        pipeline.receive_selection(self.site, selection, self._now_s)

    def _solve(self) -> None:
        self.site.dirty = True
        while self.site.dirty:  # choosing an anchor makes it dirty once more
            pipeline.solve(self.site, self._now_s)
        pipeline.note_components(self.site)
        pipeline.judge_correspondences(self.site)


def named_pairs(names: Sequence[str]) -> list[RobotPair]:
    """All pairs of robots, in order of their names."""
    ordered = sorted(names)
    return [ordered_pair(a, b) for k, a in enumerate(ordered) for b in ordered[k + 1 :]]
