"""What the server knows of its site: views, tracks, links between keyframes, the operator's work,
the solution.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.clocks import LEAST_AHEAD_S
from fleetpose.pose_server.calibration.history import DepthHistory
from fleetpose.pose_server.correspondences.lifting import Lifter
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend.frames import upright
from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.geometry.se3 import compose_covariance, inverse, make_pose
from fleetpose.pose_server.pose_graph.types import Edge, EdgeKey, FleetSolution
from fleetpose.pose_server.retrieval.view_index import ViewIndex
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.pose_server.scheduling.weighted_round_robin import WeightedRoundRobin
from fleetpose.pose_server.settings import RecipeName
from fleetpose.pose_server.state.affine_retries import AffineRetries
from fleetpose.pose_server.state.alarms import Alarms, RouterDenials
from fleetpose.pose_server.state.click_caches import ClickCaches
from fleetpose.pose_server.state.doubts import Doubts
from fleetpose.pose_server.state.odometry import Odometers
from fleetpose.pose_server.state.origins import Anchoring
from fleetpose.pose_server.state.pair_queue import PairQueue
from fleetpose.pose_server.state.pairs import Agenda, PairRecord, ViewPair
from fleetpose.pose_server.state.question_feedback import QuestionFeedback
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.views import KeptView, ViewStore, likeness, same_camera
from fleetpose.pose_server.workers.jobs import EncodedView
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import RobotPair, ordered_pair
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]
PINNED_S = 60.0  # a client repeats what it holds every few seconds
MAX_PINS = 64
MAX_CHANGES_TOLD = 5
MAX_HELD_BACK = 100
MAX_HELD_BACK_BYTES = 64 * 1024 * 1024
MAX_ROBOTS = 1000
MAX_EPOCHS = 8  # tokens under one name at a time


class SiteFullError(FleetPoseError):
    """More robots, or more lives of one, than a site can have."""


@dataclass(frozen=True)
class Pin:
    """The views that an operator's client holds on its screen, and when it said so last."""

    views: tuple[ViewName, ...]
    said_s: float


@dataclass
class Site:
    """The state of one site. Only the server's own thread touches it.

    Attributes:
        located_sigma: largest position sigma of a located robot, share of the depth.
        located_grave: largest probability that a located robot is gravely off.
        recipe, icp: how pairs are aligned, and their clouds brought together.
        pins: by operator and session.
        agenda: which pairs are at work, due and aligned.
        pair_queue: which pairs wait to be aligned.
        weights: what makes them wait for less.
        kinds: of work of which each has its share.
        partners: of each robot, those of which a pair record is there.
        repetition: share of pairs that told the last solve of a place that repeats itself.
        touched: robots of pairs that were aligned and not told of since.
        covariances: the solve in which that of a keyframe was made last.
        depth_m: median over the keyframes.
        held_back: the newest view of each name whose token was not seen yet.
        depths: what pairs say of the robots' depths.
        affine_retries: pairs that wait for affine keypoints.
        feedback: what became of the questions.
        odometers: what robots say of their own motion.
        clicks: what was worked out of the correspondences.
        alarms: about calibrations and clocks.
        denials: what routers say that they deny.
        doubts: which robots' poses are not believed, and why.
        anchoring: which origins the fleet has had.
        view_index: keyframes by their looks.
    """

    correspondences: CorrespondenceStore
    skip: frozenset[RobotPair] = frozenset()
    located_sigma: float = 0.05
    located_grave: float = 0.05
    recipe: RecipeName = "full"
    icp: IcpMethod = "gicp"
    anchor: str | None = None
    views: ViewStore = field(default_factory=ViewStore)
    robots: dict[str, Robot] = field(default_factory=dict)
    pairs: dict[RobotPair, PairRecord] = field(default_factory=dict)
    agenda: Agenda = field(default_factory=Agenda)
    edges: dict[EdgeKey, Edge] = field(default_factory=dict)
    pins: dict[tuple[str, str], Pin] = field(default_factory=dict)
    held_back: dict[str, KeptView] = field(default_factory=dict)
    solution: FleetSolution | None = None
    gauge_revision: int = 0
    pair_queue: PairQueue = field(default_factory=PairQueue)
    weights: Weights = field(default_factory=Weights)
    kinds: WeightedRoundRobin[str] = field(default_factory=WeightedRoundRobin)
    depth_m: float = 1.0
    dirty: bool = False
    repetition: float = 0.0
    partners: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    touched: set[str] = field(default_factory=set)
    covariances: dict[ViewName, int] = field(default_factory=dict)
    events: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    gauge: ViewName | None = None
    components: dict[str, str] = field(default_factory=dict)
    lifter: Lifter = field(default_factory=Lifter)
    depths: DepthHistory = field(default_factory=DepthHistory)
    affine_retries: AffineRetries = field(default_factory=AffineRetries)
    feedback: QuestionFeedback = field(default_factory=QuestionFeedback)
    odometers: Odometers = field(default_factory=Odometers)
    clicks: ClickCaches = field(default_factory=ClickCaches)
    alarms: Alarms = field(default_factory=Alarms)
    denials: RouterDenials = field(default_factory=RouterDenials)
    doubts: Doubts = field(default_factory=Doubts)
    view_index: ViewIndex = field(default_factory=ViewIndex)
    anchoring: Anchoring = field(default_factory=Anchoring)
    _similarities: dict[ViewPair, float] = field(default_factory=dict)
    _edge_counts: Counter[RobotPair] = field(default_factory=Counter[RobotPair])

    def robot(self, name: str) -> Robot:
        """The robot's record, made when first heard of."""
        return self.robots.setdefault(name, Robot(name))

    def newcomer(self, name: str) -> Robot:
        """The record of a robot whose token is there; where there are too many, those that are gone
        and left nothing make room.

        Raises:
            SiteFullError: there is none.
        """
        if name not in self.robots and len(self.robots) >= MAX_ROBOTS:
            gone = [r.name for r in self.robots.values() if not r.alive and not self.has_of(r.name)]
            for other in gone:
                del self.robots[other]
            if not gone:
                raise SiteFullError(f"a robot too many: {MAX_ROBOTS} are known, '{name}' is not")
        robot = self.robot(name)
        if len(robot.epochs) >= MAX_EPOCHS:
            raise SiteFullError(f"too many tokens under one name: {MAX_EPOCHS} of '{name}'")
        return robot

    def has_of(self, name: str) -> bool:
        """Whether anything that a robot showed is kept, maybe of a life before this server's."""
        clicked = any(view.robot == name for view in self.correspondences.views())
        return clicked or bool(self.robots[name].track.keyframes)

    def forget_robot(self, name: str) -> None:
        """A robot that never showed anything is gone."""
        del self.robots[name]

    def knows(self, pair: RobotPair) -> bool:
        """Whether two names are a pair of robots that are known, or between which something was; in
        order, as keys name pairs.
        """
        a, b = pair
        known = self.correspondences.has(a, b) or (a in self.robots and b in self.robots)
        return a < b and known

    def pair(self, a: str, b: str) -> PairRecord:
        """The pair's record, made when first needed."""
        pair = ordered_pair(a, b)
        record = self.pairs.get(pair)
        if record is None:
            record = self.pairs[pair] = PairRecord(pair, self.agenda)
            if a != b:
                self.partners[a].append(b)
                self.partners[b].append(a)
        return record

    def count(self, what: str, by: int = 1) -> None:
        """Counts something for the status."""
        self.counts[what] = self.counts.get(what, 0) + by

    def say(self, event: str) -> None:
        """An event that operators see."""
        self.events = [*self.events[-19:], event]

    def want_solution(self) -> None:
        """Something changed that the next solve is to take in."""
        self.dirty = True

    def solved(self, solution: FleetSolution) -> None:
        """Poses are as this solution says."""
        self.solution, self.dirty = solution, False
        self.count("solves")

    def set_depth(self, depth_m: float) -> float:
        """How deep the fleet's views are; returns it."""
        self.depth_m = depth_m
        return depth_m

    def set_repetition(self, share: float) -> float:
        """How much of the place repeats itself; returns it."""
        self.repetition = share
        return share

    def set_anchor(self, robot: str | None) -> None:
        """A robot is the anchor from the next solve on, or none is."""
        self.anchor = robot
        self.want_solution()

    def set_gauge(self, view: ViewName | None) -> None:
        """A keyframe is the origin of the fleet's frame."""
        self.gauge = view

    def raise_revision(self) -> None:
        """Poses before and after now do not compare."""
        self.gauge_revision += 1

    def renew_components(self, now: dict[str, str]) -> dict[str, str]:
        """The component of each robot; of those that are in another one, where they were."""
        before, self.components = self.components, now
        return {
            name: before[name]
            for name, component in now.items()
            if before.get(name, component) != component
        }

    def take_turns(self, here: set[ViewName], new: set[ViewName], most: int) -> set[ViewName]:
        """Keyframes whose covariances are made in the next solve: the new ones, and so many of
        those here of which it is oldest.
        """
        asked = {view: at for view, at in self.covariances.items() if view in here}
        oldest = sorted(here - new, key=lambda view: asked.get(view, -1))[:most]
        due = new.union(oldest)
        self.covariances = asked | dict.fromkeys(due, self.counts.get("solves", 0))
        return due

    def touch(self, *robots: str) -> None:
        """Something about a robot is to be told anew."""
        self.touched.update(robots)

    def note_told(self) -> None:
        """All of that was told."""
        self.touched.clear()

    def similarity(self, a: ViewName, b: ViewName) -> float:
        """The likeness of two kept keyframes, computed once."""
        known = self.known_similarity(a, b)
        if known is None:
            known = self._similarities[_in_order(a, b)] = likeness(self.views[a], self.views[b])
        return known

    def known_similarity(self, a: ViewName, b: ViewName) -> float | None:
        """The same, if it was computed."""
        return self._similarities.get(_in_order(a, b))

    def forget_keyframe(self, view: ViewName) -> None:
        """A keyframe is none any more."""
        for key in [key for key in self.edges if view in key[:2]]:
            self.unlink(key)
        self.anchoring.forget(view)
        self._similarities = {at: v for at, v in self._similarities.items() if view not in at}
        for record in self.pairs.values():
            record.forget(view)

    def keyframes(self) -> list[ViewName]:
        """Of all robots."""
        return [keyframe for robot in self.robots.values() for keyframe in robot.track.keyframes]

    def newest_keyframes(self) -> dict[str, ViewName]:
        """The keyframe that each robot's newest view hangs on, by robot in order of name."""
        return {
            name: robot.track.newest.keyframe
            for name, robot in sorted(self.robots.items())
            if robot.track.newest is not None
        }

    def newest_view(self, name: str) -> KeptView | None:
        """The newest view of a robot, if there is one."""
        robot = self.robots.get(name)
        return None if robot is None or robot.newest is None else self.views.get(robot.newest)

    def encoded(self, view: ViewName) -> EncodedView:
        """A view for a worker that aligns two robots, without what moves in it, and with its wide
        set where there is one.
        """
        mask = self.robot(view.robot).track.masks.get(view)
        return replace(self.views[view].encoded, mask=mask, wide=self.affine_retries.of(view))

    def attached(self, view: ViewName) -> KeyframeRelativePose | None:
        """Where a view hangs."""
        robot = self.robots.get(view.robot)
        return None if robot is None else robot.track.attached.get(view)

    def held(self) -> set[ViewName]:
        """Views that must be kept: keyframes, selected ones, those with correspondences, those in
        work.
        """
        held = set(self.keyframes()) | self.correspondences.views()
        for pin in self.pins.values():
            held.update(pin.views)
        for robot in self.robots.values():
            at_work = (
                robot.newest,
                robot.waiting,
                robot.tracking,
                robot.past_in_flight,
                *robot.past_queue,
            )
            held.update(view for view in at_work if view is not None)
        held.update(view for views in self.affine_retries.waiting for view in views)
        return held

    def pin(self, client: tuple[str, str], views: tuple[ViewName, ...], now_s: float) -> None:
        """Holds views for an operator's client in place of those it held before."""
        self.pins.pop(client, None)
        fresh = [(key, pin) for key, pin in self.pins.items() if now_s - pin.said_s < PINNED_S]
        self.pins = dict(fresh[-MAX_PINS + 1 :])
        if views:
            self.pins[client] = Pin(views, now_s)

    def pinned(self) -> tuple[ViewName, ...]:
        """The views that operators hold on their screens and that are kept."""
        held = dict.fromkeys(view for pin in self.pins.values() for view in pin.views)
        return tuple(view for view in held if view in self.views)

    def hold_back(self, view: KeptView) -> None:
        """Keeps the newest view of a name whose token is not there, until it is."""
        name = view.name.robot
        if self.held_back.pop(name, None) is not None or len(self.held_back) >= MAX_HELD_BACK:
            self.count("without_token")
        waiting = sum(len(other.payload) for other in self.held_back.values())
        if len(self.held_back) < MAX_HELD_BACK and waiting < MAX_HELD_BACK_BYTES:
            self.held_back[name] = view

    def take_held_back(self, name: str) -> KeptView | None:
        """The view that waited for a name's token, which is there."""
        return self.held_back.pop(name, None)

    def note_change(self, robot: Robot, view: KeptView) -> None:
        """Tells, a few times, when a robot's calibration changed or its clock went back."""
        before, back_s = robot.camera, 1e-9 * (robot.stamp_ns - view.stamp_ns)
        told = []
        if before is not None and not same_camera(before, view.camera):
            told.append(f"{robot.name} has another calibration from its view {view.name.seq} on")
            self.depths.forget(robot.name)
            self.alarms.forget(robot.name)
        if back_s > 0:
            told.append(f"the clock of {robot.name} went back by {back_s:.1f} s")
        if back_s > LEAST_AHEAD_S:  # it was set: what was noted of it before tells nothing
            self.odometers.clock_went_back(robot.name)
            self.depths.clocks.forget(robot.name)
        robot.note_camera(view, len(told))
        if robot.changes <= MAX_CHANGES_TOLD:
            for event in told:
                self.say(event)

    def edge_count(self, a: str, b: str) -> int:
        """Links between two robots."""
        return self._edge_counts[ordered_pair(a, b)]

    def camera_pose(self, view: ViewName) -> tuple[ViewName, Floats, Floats | None] | None:
        """Root of its component, T_root_camera and covariance of a view that hangs somewhere."""
        here = self.attached(view)
        if here is None or self.solution is None or here.keyframe not in self.solution.nodes:
            return None
        node = self.solution.nodes[here.keyframe]
        T = node.T_root_camera @ here.T_keyframe_view
        if node.covariance is None:
            return node.root, T, None
        return (
            node.root,
            T,
            compose_covariance(node.T_root_camera, node.covariance, here.covariance),
        )

    def relative(self, a: ViewName, b: ViewName) -> Floats | None:
        """T_a_b of two views' cameras by the solution, or None where nothing joins them."""
        if not self.joined(a, b):
            return None
        return inverse(self._T_root_camera(a)) @ self._T_root_camera(b)

    def _T_root_camera(self, view: ViewName) -> Floats:
        here = self.attached(view)
        assert here is not None and self.solution is not None
        return self.solution.nodes[here.keyframe].T_root_camera @ here.T_keyframe_view

    def component_name(self, root: ViewName) -> str:
        """The anchor's name for its component, else the root's robot and view: poses compare only
        within one.
        """
        return root.robot if root == self.gauge else f"{root.robot[:16]}-{root.seq}"

    def joined(self, a: ViewName, b: ViewName) -> bool:
        """Whether two views share a component."""
        at_a, at_b = self.attached(a), self.attached(b)
        if at_a is None or at_b is None or self.solution is None:
            return False
        return self.solution.joined(at_a.keyframe, at_b.keyframe)

    def fleet_from_root(self, root: ViewName) -> Floats:
        """T_fleet_root: the fleet frame is the body of the root's robot, turned upright where
        gravity is known: by all that knew it when the frame was levelled, else by the root itself.
        """
        kept, R_fleet_robot = self.views[root], self.anchoring.levels.get(root)
        T_robot_camera = kept.camera.T_robot_camera
        if R_fleet_robot is not None:
            return make_pose(R_fleet_robot, np.zeros(3)) @ T_robot_camera
        if kept.up_camera is None:
            return T_robot_camera
        return upright(T_robot_camera[:3, :3] @ kept.up_camera) @ T_robot_camera

    def knows_up(self, root: ViewName) -> bool:
        """Whether z is up in the frame of a component."""
        return root in self.anchoring.levels or self.views[root].up_camera is not None

    def link(self, edge: Edge) -> None:
        """Adds or replaces a link between two keyframes."""
        if edge.key not in self.edges:
            self._edge_counts[ordered_pair(edge.a.robot, edge.b.robot)] += 1
        self.edges[edge.key] = edge
        self.dirty = True

    def unlink(self, key: EdgeKey) -> None:
        """Removes a link."""
        if self.edges.pop(key, None) is not None:
            self._edge_counts[ordered_pair(key[0].robot, key[1].robot)] -= 1
            self.dirty = True


def _in_order(a: ViewName, b: ViewName) -> ViewPair:
    return (a, b) if str(a) < str(b) else (b, a)
