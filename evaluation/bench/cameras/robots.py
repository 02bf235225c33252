"""Row: a robot whose camera fails while it runs is named, in its own log, in the fleet's status and
in `why`, and nobody is asked about it. The server's pipeline is driven without a network.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fleetpose.evaluation.bench.cameras.bars import Attempt, Bar
from fleetpose.evaluation.bench.cameras.made.scene import RIG, Image, scene
from fleetpose.evaluation.simulate.stereo_video import shot_through_lenses
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.correspondences.records import BookState
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.questions.facts import questions
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import View, ViewName, WhyNot
from fleetpose.robot_agent.agent import Sight
from fleetpose.robot_agent.cameras.base import DisparityImage, Frame
from fleetpose.robot_agent.cameras.frozen import Repeats
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.checking.told import Told
from fleetpose.robot_agent.features.keypoints import salient_points
from fleetpose.robot_agent.features.packing import view_of

WITHIN_S = 5
_BEFORE_S = 2
_STEP_M = 0.25  # that the robot drives in a second
_NAMES = ("r1", "r2")
_EPOCH = "0" * 12
Eyes = tuple[Image, Image]


@dataclass
class Device:
    """A stereo camera that drives ahead, a pair a second, and fails at a time.

    Attributes:
        spoil: what it makes of the eyes' images, given also the last ones before it failed.
    """

    spoil: Callable[[Eyes, Eyes], Eyes]
    last: Eyes | None = None

    def eyes(self, at_s: int) -> Eyes:
        """Both eyes (H, W, 3) at a time; it fails at 0."""
        T_world_left = np.eye(4)
        T_world_left[2, 3] = _STEP_M * at_s
        rng = np.random.default_rng(at_s + 100)
        left, right = (
            np.clip(eye + rng.normal(0, 1.5, eye.shape), 0, 255).astype(np.uint8)
            for eye in shot_through_lenses(scene(0), T_world_left, RIG)
        )
        if at_s < 0 or self.last is None:
            self.last = left, right
            return left, right
        return self.spoil((left, right), self.last)


def _thinned(frame: Frame) -> Frame:
    """Its disparities but for 3 % of them."""
    assert isinstance(frame.ranges, DisparityImage)
    keep = np.random.default_rng(0).random(frame.ranges.disparity_px.shape) < 0.03
    thin = np.where(keep, frame.ranges.disparity_px, np.nan).astype(np.float32)
    return replace(frame, ranges=replace(frame.ranges, disparity_px=thin))


SOUND = "nothing fails"
FAULTS: dict[str, Callable[[Eyes, Eyes], Eyes]] = {
    SOUND: lambda now, last: now,
    "an eye freezes": lambda now, last: (now[0], last[1]),
    "both eyes freeze": lambda now, last: last,
    "an eye goes dark": lambda now, last: (now[0], np.zeros_like(now[1])),
    "the left eye goes dark": lambda now, last: (np.zeros_like(now[0]), now[1]),
    "eyes are swapped": lambda now, last: (now[1], now[0]),
    "97 % of the depth is lost": lambda now, last: now,
}


def bar() -> Bar:
    """Every fault, each of a fleet of its own."""
    attempts = [one for name in FAULTS for one in tried(name)]
    return Bar("e cameras that fail", attempts, unit=f"named within {WITHIN_S} s")


def tried(name: str) -> Iterator[Attempt]:
    """One fault: four attempts, that its robot is named in each place, and not asked about."""
    device, matcher, repeats = Device(FAULTS[name]), StereoMatcher(RIG), Repeats("r2")
    site, sight = Site(CorrespondenceStore(_Forgetful())), Sight("r2")
    thin = _thinned if name.startswith("97") else (lambda frame: frame)
    named: dict[str, int] = {}
    texts: dict[str, str] = {}
    asked = False
    with Told() as told:
        for at_s in range(-_BEFORE_S, WITHIN_S + 1):
            eyes = device.eyes(at_s)
            told.lines.clear()
            frame = matcher.frame(*eyes, stamp_ns=(at_s + 100) * 10**9)
            frame = replace(frame, frozen_s=repeats.frozen_s(eyes, float(at_s)))
            frame = thin(frame) if at_s >= 0 else frame
            sight.log(frame)
            _receive(site, "r1", frame if at_s < 0 else None, at_s)
            _receive(site, "r2", frame, at_s)
            for where, text in _said(site, told.lines, at_s).items():
                if text and at_s >= 0 and where not in named:
                    named[where], texts[where] = at_s, text
            asked |= "status" in named and any("r2" in (q.i, q.j) for q in questions(site))
    for where in ("log", "status", "why"):
        if name == SOUND:
            yield Attempt(f"{name}: {where}", where not in named, texts.get(where, "not named"))
            continue
        says = f"after {named[where]} s: {texts[where]}" if where in named else "not named"
        yield Attempt(f"{name}: {where}", where in named, says)
    yield Attempt(f"{name}: no question", not asked, "asked about" if asked else "not asked about")


def _receive(site: Site, name: str, frame: Frame | None, at_s: int) -> None:
    """A view arrives, and what it leads to is worked off."""
    if frame is not None:
        seq = at_s + 100
        view = view_of(
            ViewName(robot=name, epoch=_EPOCH, seq=seq),
            frame,
            salient_points(frame.image, frame.ranges, frame.model),
        )
        pipeline.receive_token(site, name, _EPOCH, True)
        try:
            kept = open_view(pack(view), encoding_of(View), float(at_s))
            pipeline.receive_view(site, kept)
        except CodecError as error:  # as the server's shell does
            pipeline.refuse_view(site, name, error)
    while (job := pipeline.urgent_job(site) or pipeline.next_job(site, float(at_s))) is not None:
        pipeline.take_result(site, Done(job, run_job(job)), float(at_s))
    pipeline.solve(site, float(at_s))


def _said(site: Site, lines: list[str], at_s: int) -> dict[str, str]:
    """What is said of the robot, by where."""
    alarms = [
        alarm.text
        for alarm in monitor.standing(site)
        if alarm.robot == "r2" and alarm.kind in ("blind", "frozen")
    ]
    why = builders.why_not(site, "r2", ServerSettings.model_validate({}), float(at_s))
    told = why.alarms if isinstance(why, WhyNot) else ()
    log = [line for line in lines if "hardly any depth" in line or "camera frozen" in line]
    in_why = [text for text in told if text in alarms]
    return {"log": "; ".join(log), "status": "; ".join(alarms), "why": "; ".join(in_why)}


class _Forgetful:
    """A recorder of clicks that keeps none."""

    def load(self) -> BookState:
        return BookState()

    def record(self, change: object) -> None:
        """Keeps nothing."""
