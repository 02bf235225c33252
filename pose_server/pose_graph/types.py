"""What goes into the fleet solve and what comes out of it.

A node is a view; its pose is its camera's. Covariances are (6, 6), rotation then translation, of
left perturbations, `exp(xi) T_a_b`; metres and radians.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.protocol.messages import Verdict, ViewName

Floats = npt.NDArray[np.floating]
EdgeKind = Literal["odometry", "pair"]
EdgeKey = tuple[ViewName, ViewName, EdgeKind]
Told = tuple[int, Any]
"""Fingerprint of the points clicked in two keyframes, and what they said: a `ClickSummary`."""

GRAVE_BY_VERDICT: dict[Verdict, float] = {
    "verified": 0.001,  # none in some thousand verified pairs of the recordings at hand
    "plausible": 0.5,  # in places that repeat themselves most of them are aliases
    "ambiguous": 0.5,
    "rejected": 1.0,
}
"""Probability that an edge is gravely off, where nobody says how likely that is."""
GRAVE_ODOMETRY = 0.005
"""The same of a robot's own motion: it begins where the robot was, and finds no alias elsewhere."""


JOINS_BELOW = 0.5
"""Clicks that are more likely wrong than right join nothing, nor do those that nobody has heard."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured relative pose of two keyframes; at most one per (a, b, kind).

    Attributes:
        T_a_b: (4, 4) camera of view b in camera of view a.
        covariance: (6, 6) of T_a_b.
        verdict: of the alignment; only `verified` and `plausible` ones are used, and operator edges
            unless `rejected`.
        kind: `odometry` between views of one robot, `pair` between robots.
        operator: three or more of the operator's correspondences agree with it.
        grown: from them, so that they are in it.
        p_grave: probability that it is gravely off; by default what its verdict stands for.
        structure: what of the world it rests on, in the frame of view a; None where that is not
            known: such an edge is nobody's independent witness.
        singled_out: rivals that the place's repetitions offered were beaten by what is there only
            once.
    """

    a: ViewName
    b: ViewName
    T_a_b: Floats
    covariance: Floats
    verdict: Verdict = "verified"
    kind: EdgeKind = "pair"
    operator: bool = False
    grown: bool = False
    p_grave: float = -1.0
    structure: Structure | None = None
    singled_out: bool = False

    def __post_init__(self) -> None:
        if self.p_grave < 0.0:
            known = GRAVE_BY_VERDICT[self.verdict]
            p_grave = min(known, GRAVE_ODOMETRY) if self.kind == "odometry" else known
            object.__setattr__(self, "p_grave", p_grave)

    @property
    def key(self) -> EdgeKey:
        return (self.a, self.b, self.kind)


@dataclass(frozen=True, eq=False)
class ClickFactor:
    """One point that the operator clicked in two views.

    Attributes:
        p_a, p_b: (3,) the point in the camera frame of each view.
        C_a, C_b: (3, 3) its covariances there, long along the ray.
        id: of the correspondence.
        p_grave: probability that what it says, with the others that it was heard with, is gravely
            off, by what the images said. From `JOINS_BELOW` on it joins no components.
    """

    a: ViewName
    b: ViewName
    p_a: Floats
    p_b: Floats
    C_a: Floats
    C_b: Floats
    id: int
    p_grave: float = 0.006

    @property
    def joins(self) -> bool:
        """Whether it may join components, with others."""
        return self.p_grave < JOINS_BELOW


@dataclass(frozen=True)
class SolveSettings:
    """What the solver takes as given; metres are to be set from the scene's depth by the caller.

    Attributes:
        floor_rotation_rad, floor_translation_m: added to every edge's sigmas: edges of one pair
            share their bias.
        agree_rotation_rad, agree_translation_m: how far two edges may differ and still be said to
            agree.
        distinct_m: two edges are different evidence only if a camera of one stands this far from
            the other's, or is another robot's: a robot that stands still repeats its mistakes.
        most_grave: probability of being gravely off up to which plausible edges that are
            independent witnesses join components together.
        inlier_probability: share of right edges that pass the test against outliers.
        click_robust_sigmas: from where on a click counts less.
        shared_share: of an edge's variance that it has in common with another edge of one of its
            views on the same points: less than half, since the other half is the other view's. Set
            by `pose-eval restarts --offline` of church_herzjesu and ring_temple.
        unit_weight: squared residual of an edge per degree of freedom, where its covariance is
            right: the rest of its error is its views' own and shows in no cycle. A fleet that
            closes better is surer than its edges say.
        unit_weight_dof: degrees of freedom that this expectation counts as.
        least_variance: to which share of what edges say covariances may fall by that.
        outvoted_limit: so many new edges may be set aside as outvoted before all edges are judged
            anew.
    """

    floor_rotation_rad: float = 3e-4
    floor_translation_m: float = 3e-4
    agree_rotation_rad: float = 0.08
    agree_translation_m: float = 0.1
    distinct_m: float = 0.1
    most_grave: float = 0.02
    inlier_probability: float = 0.999
    click_robust_sigmas: float = 4.0
    outvoted_limit: int = 8
    shared_share: float = 0.4
    unit_weight: float = 0.4
    unit_weight_dof: float = 12.0
    least_variance: float = 0.25

    @classmethod
    def at_depth(cls, depth_m: float) -> "SolveSettings":
        """Settings for a scene of this median depth."""
        return cls(
            floor_translation_m=3e-4 * depth_m,
            agree_translation_m=0.05 * depth_m,
            distinct_m=0.02 * depth_m,
        )


@dataclass(frozen=True, eq=False)
class NodePose:
    """Where a keyframe's camera is.

    Attributes:
        T_root_camera: (4, 4) in the camera frame of the component's root.
        root: the root of its component.
        verdict: of the weakest link on the strongest path to the root; `ambiguous` where a link is
            contradicted by another one and nothing tells which of them is wrong.
        parent: the next view on that path, None for the root.
        p_grave: probability that the pose is gravely off beside the root's: that any edge of the
            surest way to the root is, and nothing independent confirms it.
        covariance: (6, 6) of T_root_camera; None where it was not asked for or could not be had.
        why_no_covariance: the reason, empty if there is one.
    """

    T_root_camera: Floats
    root: ViewName
    verdict: Verdict
    parent: ViewName | None
    covariance: Floats | None = None
    why_no_covariance: str = "not asked for"
    p_grave: float = 0.0


@dataclass(frozen=True)
class EdgeJudgement:
    """What the solve thinks of an edge.

    Attributes:
        weight: 1 used, 0 not.
        distance2: squared Mahalanobis distance between measurement and solution, 6 dof; nan where
            the two views are in different components.
        outlier: it contradicts the others.
        contested: a bridge that an outlier contradicts: one of the two is wrong, and nothing tells
            which.
    """

    weight: float
    distance2: float
    outlier: bool
    contested: bool = False


@dataclass(frozen=True)
class ClickJudgement:
    """How a click fits the solution.

    Attributes:
        used: it was a factor of its own (not merged into an operator edge, both views in one
            component).
        residual_m: |p_a - T_a_b p_b|; nan where the two views are in different components.
        distance2: the same, squared Mahalanobis, 3 dof.
        outlier: beyond the inlier probability.
    """

    used: bool
    residual_m: float
    distance2: float
    outlier: bool


@dataclass(frozen=True)
class Bridge:
    """Plausible edges between two components that do not suffice to join them.

    Attributes:
        root_a, root_b: roots of the two components.
        edges: the edges, most certain first.
    """

    root_a: ViewName
    root_b: ViewName
    edges: tuple[Edge, ...]


@dataclass(frozen=True)
class Relative:
    """T_a_b (4, 4) of two cameras, its covariance (6, 6), and the views on the way from a to b."""

    T_a_b: Floats
    covariance: Floats | None
    path: tuple[ViewName, ...]


@dataclass(frozen=True, eq=False)
class FleetSolution:
    """All keyframes' poses, component by component.

    Attributes:
        nodes: pose of every node given.
        components: members by root, the gauge's component first, then by size.
        edges: judgement of every edge given.
        clicks: judgement of every click given, by id.
        bridges: what does not join.
        judged: whether all edges were weighed against each other in this solve (graduated non-
            convexity).
        outvoted: edges set aside since then without that.
        told: what the clicks between two keyframes said, for the next solve.
    """

    nodes: dict[ViewName, NodePose]
    components: dict[ViewName, tuple[ViewName, ...]]
    edges: dict[EdgeKey, EdgeJudgement]
    clicks: dict[int, ClickJudgement]
    bridges: tuple[Bridge, ...]
    judged: bool
    outvoted: int = 0
    uncertainty: Any = field(default=None, repr=False)  # factors.Uncertainty; keeps gtsam out
    told: dict[tuple[ViewName, ViewName], Told] = field(default_factory=dict, repr=False)

    def joined(self, a: ViewName, b: ViewName) -> bool:
        """Whether both are known and in one component."""
        return a in self.nodes and b in self.nodes and self.nodes[a].root == self.nodes[b].root

    def relative(self, a: ViewName, b: ViewName) -> Relative | None:
        """Camera b in camera a, or None if nothing joins them; common errors are accounted for."""
        if not self.joined(a, b):
            return None
        T_a_b = inverse(self.nodes[a].T_root_camera) @ self.nodes[b].T_root_camera
        covariance = None if self.uncertainty is None else self.uncertainty.relative(a, b)
        return Relative(T_a_b, covariance, self._path(a, b))

    def _path(self, a: ViewName, b: ViewName) -> tuple[ViewName, ...]:
        up_a, up_b = self._ancestors(a), self._ancestors(b)
        common = next(node for node in up_a if node in up_b)
        down = up_b[: up_b.index(common)]
        return (*up_a[: up_a.index(common) + 1], *reversed(down))

    def _ancestors(self, node: ViewName) -> list[ViewName]:
        line = [node]
        while (parent := self.nodes[line[-1]].parent) is not None:
            line.append(parent)
        return line
