"""Following one robot through its own views: which keyframe a view hangs on, and when it becomes
one itself.

A view that moved little hangs on its keyframe by their alignment. One that moved far hangs on
another keyframe if the robot came back to it, and becomes a keyframe otherwise. One that aligns
with nothing starts a new segment.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.trajectory import Trajectory
from fleetpose.pose_server.geometry.features.motion import Mask
from fleetpose.pose_server.geometry.se3 import rotation_angle
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.protocol.messages import Verdict, ViewName

Floats = npt.NDArray[np.floating]

FAR_SHARE = 0.12  # of the median depth: a view farther from its keyframe becomes one
FAR_RAD = 0.2
LITTLE_OVERLAP = 0.4
_TRIES = 3  # keyframes that a view is tried against before it starts a segment


@dataclass(frozen=True)
class KeyframeRelativePose:
    """A view hanging on a keyframe (maybe itself): T_keyframe_view of their cameras, covariance
    left.
    """

    view: ViewName
    keyframe: ViewName
    T_keyframe_view: Floats
    covariance: Floats
    verdict: Verdict


Step = Literal["attached", "try", "keyframe", "segment"]


@dataclass
class Track:
    """One robot's keyframes and where its views hang.

    Attributes:
        keyframes: oldest first.
        attached: of all kept views that hang somewhere.
        reference: the keyframe that the next view is tried against first.
        newest: the newest view that hangs somewhere.
        past: older views that are being placed: they do not tell where the robot is now.
        masks: where something moves, of the views of which that is known.
        blind: keyframes in a row that hang by odometry alone.
        trajectory: where views hang, also those that are no longer kept.
        motion_s: when something was seen to move last, by the server's monotonic clock;
            motion_told: whether operators were told of that.
    """

    keyframes: list[ViewName] = field(default_factory=list)
    attached: dict[ViewName, KeyframeRelativePose] = field(default_factory=dict)
    reference: ViewName | None = None
    newest: KeyframeRelativePose | None = None
    past: set[ViewName] = field(default_factory=set)
    masks: dict[ViewName, Mask] = field(default_factory=dict)
    trajectory: Trajectory = field(default_factory=Trajectory)
    motion_s: float = -np.inf
    motion_told: bool = False
    blind: int = 0
    _tried: dict[ViewName, list[ViewName]] = field(default_factory=dict)
    _fallback: dict[ViewName, KeyframeRelativePose] = field(default_factory=dict)

    def begin(self, view: ViewName) -> None:
        """Makes a view a keyframe that hangs on nothing else."""
        if view not in self.keyframes:
            self.keyframes.append(view)
        self.hang(KeyframeRelativePose(view, view, np.eye(4), np.zeros((6, 6)), "verified"))

    def recall(self, view: ViewName) -> None:
        """Makes a view of an earlier life a keyframe, without taking it for where the robot is
        now.
        """
        if view not in self.keyframes:
            self.keyframes.append(view)
        self.attached[view] = KeyframeRelativePose(
            view, view, np.eye(4), np.zeros((6, 6)), "verified"
        )

    def recall_at(self, here: KeyframeRelativePose) -> None:
        """Hangs a view of an earlier life where it hung then."""
        self.attached[here.view] = here

    def hang(self, here: KeyframeRelativePose) -> None:
        """Hangs a view on a keyframe; if it is none of the past, the robot is there now."""
        self.attached[here.view] = here
        if here.view not in self.past:
            self.reference = here.keyframe
            self.newest = here
        self._tried.pop(here.view, None)
        self._fallback.pop(here.view, None)

    def mask(self, masks: Mapping[ViewName, Mask | None]) -> None:
        """What moves in views, where something does."""
        self.masks |= {view: mask for view, mask in masks.items() if mask is not None}

    def note_motion(self, now_s: float, told: bool) -> None:
        """Something moves in its newest view; whether operators know."""
        self.motion_s, self.motion_told = now_s, told

    def recall_past(self, view: ViewName) -> None:
        """A view is one of the past: hung, it does not say where the robot is now."""
        self.past.add(view)

    def place_past(self, view: ViewName) -> None:
        """A view of the past hangs somewhere."""
        self.past.discard(view)

    def keyframe_near(self, view: ViewName) -> ViewName | None:
        """The keyframe that the views next in time hang on, None if none of that life does."""
        near = [here for name, here in self.attached.items() if name.epoch == view.epoch]
        nearest = min(near, key=lambda here: abs(here.view.seq - view.seq), default=None)
        return None if nearest is None else nearest.keyframe

    def next_try(self, view: ViewName, likely: Callable[[], list[ViewName]]) -> ViewName | None:
        """The keyframe to align a view with next: the reference (for a past view the keyframe of
        its time), then the likeliest others; None to give up.
        """
        tried = self._tried.setdefault(view, [])
        here = None if view in self.past else self.reference  # none after a restart as well
        first = here or self.keyframe_near(view)
        if first is not None and first in self.keyframes and first not in tried:
            tried.append(first)
            return first
        left = [
            keyframe
            for keyframe in likely()
            if keyframe in self.keyframes and keyframe not in tried
        ]
        if not left or len(tried) >= _TRIES:
            return None
        tried.append(left[0])
        return left[0]

    def take(
        self,
        view: ViewName,
        keyframe: ViewName,
        result: PairResult,
        depth_m: float,
        nearer: ViewName | None,
    ) -> Step:
        """What follows from aligning a view with a keyframe.

        Args:
            nearer: another keyframe that the view is likely near to, if any.

        Returns:
            attached: it hangs on the keyframe; try: align it with the next one; keyframe: it
                became one, linked
            to the one it was aligned with; segment: it aligned with nothing and became one by
            itself.
        """
        sure = result.verdict == "verified" or self._leads_to(keyframe, view)
        if not accepted(result) or not sure:
            return "try"
        assert result.T_i_j is not None and result.covariance is not None
        here = KeyframeRelativePose(view, keyframe, result.T_i_j, result.covariance, result.verdict)
        self.blind = 0
        if not is_far(result, depth_m):
            self.hang(here)
            return "attached"
        if nearer is not None and nearer not in self._tried.get(view, []):
            self._fallback[view] = here
            self.reference = nearer
            return "try"
        return self._promote(here)

    def give_up(self, view: ViewName) -> Step:
        """No keyframe is left to try: it becomes a keyframe, linked if it aligned with a far one
        before.
        """
        if (fallback := self._fallback.get(view)) is not None:
            return self._promote(fallback)
        self.begin(view)
        return "segment"

    def dead_reckon(self, here: KeyframeRelativePose) -> None:
        """Makes a view that aligned with nothing a keyframe, where odometry says."""
        self.blind += 1
        self._promote(here)

    def link_of(self, view: ViewName) -> KeyframeRelativePose | None:
        """For a view that was promoted: how it hung on the keyframe it was aligned with."""
        return self._fallback.pop(view, None)

    def forget(self, views: set[ViewName]) -> None:
        """Drops views that are no longer kept."""
        for view in views:
            self.attached.pop(view, None)
            self.masks.pop(view, None)
            self._tried.pop(view, None)
            self._fallback.pop(view, None)
            self.past.discard(view)
        self.keyframes = [keyframe for keyframe in self.keyframes if keyframe not in views]

    def _leads_to(self, keyframe: ViewName, view: ViewName) -> bool:
        """Whether a view is next in time to those that hang on a keyframe. Elsewhere its robot is
        to be recognised like any other, not believed because it is the same one.
        """
        near = self.keyframe_near(view) if view in self.past else self.reference
        return keyframe == near and keyframe.epoch == view.epoch

    def _promote(self, here: KeyframeRelativePose) -> Step:
        self.begin(here.view)
        self._fallback[here.view] = here
        return "keyframe"


def standing(
    view: ViewName, keyframe: ViewName, sigma_rad: float, sigma_m: float
) -> KeyframeRelativePose:
    """Where the view of a robot that did not move hangs."""
    C = np.diag([sigma_rad**2] * 3 + [sigma_m**2] * 3)
    return KeyframeRelativePose(view, keyframe, np.eye(4), C, "verified")


def accepted(result: PairResult) -> bool:
    """Whether an alignment may link two views."""
    return (
        result.T_i_j is not None
        and result.covariance is not None
        and result.verdict in ("verified", "plausible")
    )


def is_far(result: PairResult, depth_m: float) -> bool:
    """Whether a view is too far from its keyframe to hang on it."""
    assert result.T_i_j is not None
    return moved(result.T_i_j, depth_m) > 1.0 or result.overlap < LITTLE_OVERLAP


def moved(T: Floats, depth_m: float) -> float:
    """How far a relative pose is, 1 at the border of `far`."""
    shift = float(np.linalg.norm(T[:3, 3])) / (FAR_SHARE * depth_m)
    return max(shift, rotation_angle(T[:3, :3]) / FAR_RAD)
