"""Jobs: to align two views, and what became of it."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from fleetpose.pose_server.geometry.features.motion import Mask
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.registration.operator_starts import (
    Clicks,
    OperatorStart,
    gravity_between,
    operator_starts,
)
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import RecipeName
from fleetpose.protocol.messages import ViewName

_FOUND = ("verified", "plausible")


_FOUND_SIGMA = 0.02  # of a pose that features found, as a start; share of the depth


Kind = Literal["clicks", "track", "pair"]


@dataclass(frozen=True)
class EncodedView:
    """A view as it came over the wire, which workers prepare once.

    Attributes:
        name: the view.
        payload: its bytes.
        mask: where something moves in it.
        wide: bytes of the same view with the wide set of salient points, where its robot was asked.
    """

    name: ViewName
    payload: bytes
    mask: Mask | None = None
    wide: bytes | None = None


@dataclass(frozen=True)
class Job:
    """Align two views.

    Attributes:
        i, j: the views.
        starts: poses to begin from, camera j in camera i.
        features: whether to look for a start by features as well.
        recipe: how pairs are aligned.
        icp: how its clouds are brought together.
        urgent: whether an operator waits for it.
    """

    kind: ClassVar[Kind]

    i: EncodedView
    j: EncodedView
    starts: tuple[Start, ...] = ()
    features: bool = True
    recipe: RecipeName = "full"
    icp: IcpMethod = "gicp"
    urgent: bool = False

    @property
    def views(self) -> tuple[ViewName, ViewName]:
        """The names of both."""
        return self.i.name, self.j.name

    @property
    def affine(self) -> bool:
        """Whether the affine keypoints of both views are there."""
        return self.i.wide is not None and self.j.wide is not None


@dataclass(frozen=True)
class TrackJob(Job):
    """Follow one robot's own motion; i is its keyframe."""

    kind = "track"


@dataclass(frozen=True)
class PairJob(Job):
    """Align two robots by what their views show."""

    kind = "pair"


@dataclass(frozen=True)
class RetryJob(PairJob):
    """Align two robots once more, by the affine keypoints of their views.

    Attributes:
        before: what the usual keypoints gave.
    """

    before: PairResult = field(kw_only=True)


@dataclass(frozen=True)
class ClickJob(Job):
    """Align two robots by the operator's correspondences as well.

    Attributes:
        clicks: these, between the two views.
        known: what features gave for these very views: they need not be asked again.
    """

    kind = "clicks"

    clicks: Clicks = field(kw_only=True)
    known: PairResult | None = None

    def sets(self, i: PreparedView, j: PreparedView) -> list[OperatorStart]:
        """The clicks as far as they agree; one or two take their rotation from what is known of the
        views, by other robots or by features.
        """
        found, others = self.known, list(self.starts)
        if found is not None and found.T_i_j is not None and found.verdict in _FOUND:
            others.append(Start("features", found.T_i_j, _FOUND_SIGMA))
        return operator_starts(i, j, self.clicks, others, gravity_between(i, j))


@dataclass(frozen=True)
class Done:
    """A job's end: its result, or why there is none.

    Attributes:
        tries: workers that it was given to.
        worker_died: the last of them died of it, or beside it.
    """

    job: Job
    result: PairResult | None
    error: str = ""
    wall_ms: float = 0.0
    tries: int = 1
    worker_died: bool = False

    @property
    def outcome(self) -> PairResult:
        """What became of the pair: where there is no result, that it failed."""
        failed = PairResult(None, None, "rejected", (f"the alignment failed: {self.error}",))
        return self.result or failed
