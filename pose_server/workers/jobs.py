"""Jobs: to align two views, and what became of it."""

from dataclasses import dataclass
from typing import Literal

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


Purpose = Literal["clicks", "track", "pair"]


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
        purpose: for clicks, to follow one robot's own motion (i is its keyframe), or for a pair of
            robots.
        i, j: the views.
        starts: poses to begin from, camera j in camera i.
        features: whether to look for a start by features as well.
        clicks: the operator's correspondences between the two views.
        usual: what the usual salient points gave, where the wide ones are to be tried now.
        known: what features gave for these very views: they need not be asked again.
        urgent: whether an operator waits for it.
        recipe: how pairs are aligned.
        icp: how its clouds are brought together.
    """

    purpose: Purpose
    i: EncodedView
    j: EncodedView
    starts: tuple[Start, ...] = ()
    features: bool = True
    clicks: Clicks | None = None
    usual: PairResult | None = None
    known: PairResult | None = None
    urgent: bool = False
    recipe: RecipeName = "full"
    icp: IcpMethod = "gicp"

    def click_sets(self, i: PreparedView, j: PreparedView) -> list[OperatorStart]:
        """The clicks as far as they agree; one or two take their rotation from what is known of the
        views, by other robots or by features.
        """
        if self.clicks is None:
            return []
        found, others = self.known or self.usual, list(self.starts)
        if found is not None and found.T_i_j is not None and found.verdict in _FOUND:
            others.append(Start("features", found.T_i_j, _FOUND_SIGMA))
        return operator_starts(i, j, self.clicks, others, gravity_between(i, j))

    @property
    def wide(self) -> bool:
        """Whether the wide sets of both views are there."""
        return self.i.wide is not None and self.j.wide is not None


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
