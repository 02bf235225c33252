"""What a learner does, and what becomes of it: each point with the fleet before and after."""

import queue
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from fleetpose.evaluation.metrics.fleet_scoring import PoseNow, score_sample
from fleetpose.evaluation.metrics.geometry import inverse
from fleetpose.evaluation.metrics.scoring import pose_errors
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.tutor.points import Clicked, Offset, offset_of
from fleetpose.evaluation.system.tutor.truths import Truth
from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import (
    KeptView,
    OperatorUpdate,
    PairCorrespondences,
    Receipts,
    RobotPose,
    ViewName,
)
from fleetpose.protocol.transport import Sample

Taken = Literal["waiting", "accepted", "outlier", "unused", "refused", "erased"]


@dataclass(frozen=True)
class Standing:
    """How the fleet stands at a moment.

    Attributes:
        located: robots that are.
        fleet_error_m: mean over located robots but the anchor; none where no other one is.
        pair_error_m, pair_error_deg: of a pair's pose; none where the two are not in one piece.
        sigma_m: of the less sure robot of the pair, by the server; none like the error.
    """

    located: int = 0
    fleet_error_m: float | None = None
    pair_error_m: float | None = None
    pair_error_deg: float | None = None
    sigma_m: float | None = None


@dataclass
class Point:
    """A point that was clicked or moved.

    Attributes:
        n: 1 for the first.
        update: as the learner's client sent it.
        offset: how far off it is.
        before, after: the fleet when it came, and before the next one came, or in the end.
        taken: what the server made of it, in the end.
        reason: why it was refused.
        residual_m: by the server, against the pose that it believes.
    """

    n: int
    update: OperatorUpdate
    offset: Offset
    before: Standing
    after: Standing = field(default_factory=Standing)
    taken: Taken = "waiting"
    reason: str = ""
    residual_m: float | None = None
    id: int | None = None

    def told(self) -> dict[str, Any]:
        """For the report."""
        update, plain = self.update, asdict(self.offset)
        assert update.pixel_i is not None and update.pixel_j is not None
        return {
            "n": self.n,
            "moved": update.action == "move",
            "i": update.i,
            "j": update.j,
            "pixel_i": [float(x) for x in update.pixel_i],
            "pixel_j": [float(x) for x in update.pixel_j],
            **plain,
            "taken": self.taken,
            "reason": self.reason,
            "residual_m": self.residual_m,
            "before": asdict(self.before),
            "after": asdict(self.after),
        }


class Learner:
    """Follows every operator of a site. `look` is called by one thread.

    Args:
        observer: of the fleet; its session is used.
        truth: what points are held against.
        recorded: the recorded view behind a name.
    """

    def __init__(
        self, observer: Observer, truth: Truth, recorded: Callable[[ViewName], KeptView | None]
    ) -> None:
        self.points: list[Point] = []
        self._observer, self._truth, self._recorded = observer, truth, recorded
        self._heard: queue.SimpleQueue[Sample] = queue.SimpleQueue()
        self._seen: set[tuple[str, int]] = set()
        self._receipted: dict[str, int] = {}
        self._sets: dict[tuple[str, str], PairCorrespondences] = {}
        self._last_s = time.monotonic()
        keys, link = observer.keys, observer.link
        for key in (keys.updates("*"), keys.receipts("*"), keys.correspondences("*", "*")):
            link.on_latched(key, self._heard.put)

    def look(self) -> None:
        """Takes in what has come."""
        while not self._heard.empty():
            sample = self._heard.get()
            try:
                if sample.encoding == encoding_of(OperatorUpdate):
                    self._update(unpack(OperatorUpdate, sample.payload))
                elif sample.encoding == encoding_of(Receipts):
                    self._receipts(unpack(Receipts, sample.payload))
                elif sample.encoding == encoding_of(PairCorrespondences):
                    self._set(unpack(PairCorrespondences, sample.payload))
            except CodecError:
                continue  # the server counts it

    @property
    def settled_for_s(self) -> float:
        """Since when nothing was done; 0 while an update waits for its receipt."""
        waits = any(self._receipted.get(session, 0) < n for session, n in self._seen)
        return 0.0 if waits else time.monotonic() - self._last_s

    def finish(self) -> None:
        """How it all ended."""
        self.look()
        self._close_last()

    # ---- what comes ------------------------------------------------------------------------------

    def _update(self, update: OperatorUpdate) -> None:
        if (update.session, update.n) in self._seen:
            return  # it is repeated until it is receipted
        self._seen.add((update.session, update.n))
        self._last_s = time.monotonic()
        if update.action == "move":
            self._mark_moved(update)
        if update.action in ("add", "move"):
            self._close_last()
            standing = self.standing((update.i, update.j))
            self.points.append(Point(len(self.points) + 1, update, self._offset(update), standing))

    def _mark_moved(self, update: OperatorUpdate) -> None:
        for point in self._of_pair((update.i, update.j)):
            if point.id == update.correspondence:
                point.taken, point.id = "erased", None

    def _close_last(self) -> None:
        if self.points:
            last = self.points[-1]
            last.after = self.standing((last.update.i, last.update.j))

    def _receipts(self, receipts: Receipts) -> None:
        self._receipted[receipts.session] = receipts.n
        reasons = {rejection.n: rejection.reason for rejection in receipts.rejections}
        for point in self.points:
            update = point.update
            if update.session == receipts.session and update.n in reasons:
                point.taken, point.reason = "refused", reasons[update.n]

    def _set(self, told: PairCorrespondences) -> None:
        """The server's set of a pair: what is not in it any more was erased."""
        ids = {item.id for item in told.items}
        for point in self._of_pair((told.i, told.j)):
            if point.id is not None and point.id not in ids:
                point.taken = "erased"
        for item in told.items:
            for point in self._of_pair((told.i, told.j)):
                if point.id in (None, item.id) and _is(point.update, item):
                    point.id, point.taken, point.residual_m = item.id, item.status, item.residual_m

    def _of_pair(self, pair: tuple[str, str]) -> list[Point]:
        return [point for point in self.points if (point.update.i, point.update.j) == pair]

    # ---- what is true of it ----------------------------------------------------------------------

    def _offset(self, update: OperatorUpdate) -> Offset:
        sides = []
        for view, pixel in ((update.view_i, update.pixel_i), (update.view_j, update.pixel_j)):
            kept = None if view is None else self._recorded(view)
            if kept is None:
                return Offset(why="no pose")
            sides.append(Clicked(kept.view, kept.jpeg, np.asarray(pixel, np.float64)))
        return offset_of(self._truth, sides[0], sides[1])

    def standing(self, pair: tuple[str, str] | None = None) -> Standing:
        """How the fleet stands now, and a pair in it."""
        told = {robot: seen.pose for robot, seen in self._observer.poses().items()}
        poses = {robot: now for robot, pose in told.items() if (now := self._beside(pose))}
        state = self._observer.state
        anchor = None if state is None else state.anchor
        located = sum(pose.located for pose in told.values())
        rows = score_sample(0.0, tuple(poses), poses, anchor)
        errors = [
            row.position_error_m
            for row in rows
            if row.located and not row.is_anchor and row.position_error_m is not None
        ]
        mean = float(np.mean(errors)) if errors else None
        return Standing(located, mean, *_of_pair(told, poses, pair))

    def _beside(self, pose: RobotPose) -> PoseNow | None:
        kept = self._recorded(pose.view)
        true = None if kept is None else self._truth.T_world_robot(kept.view)
        if true is None:
            return None
        return PoseNow(pose.T_fleet_robot, pose.covariance, pose.component, pose.located, true)


def _is(update: OperatorUpdate, item: Any) -> bool:
    """Whether an update made a correspondence."""
    return (
        (update.view_i, update.view_j) == (item.view_i, item.view_j)
        and np.allclose(update.pixel_i, item.pixel_i, atol=0.01)  # type: ignore[arg-type]
        and np.allclose(update.pixel_j, item.pixel_j, atol=0.01)  # type: ignore[arg-type]
    )


def _of_pair(
    told: dict[str, RobotPose], poses: dict[str, PoseNow], pair: tuple[str, str] | None
) -> tuple[float | None, float | None, float | None]:
    """Error of a pair's pose, metres and degrees, and sigma of the less sure of the two, metres."""
    if pair is None or not all(robot in poses for robot in pair):
        return None, None, None
    i, j = (poses[robot] for robot in pair)
    if i.component != j.component:
        return None, None, None
    T_i_j = inverse(i.T_fleet_robot) @ j.T_fleet_robot
    error_m, error_deg = pose_errors(inverse(i.T_world_robot) @ j.T_world_robot, T_i_j)
    sigma_m = max(float(np.sqrt(np.trace(told[robot].covariance[3:, 3:]))) for robot in pair)
    return error_m, error_deg, sigma_m
