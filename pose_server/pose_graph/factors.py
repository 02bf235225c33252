"""The fleet's keyframes, edges and clicks as a gtsam factor graph, and what gtsam can do with it.

gtsam perturbs a pose from the right, `T exp(xi)`, rotation first; here covariances belong to left
perturbations. The adjoint turns one into the other. Clicks are summed up by pair of keyframes, so
that a thousand of them cost no more than three.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import adjoint, inverse, retract
from fleetpose.pose_server.pose_graph.links import Link
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]

_GAUGE_SIGMA = 1e-6
_GNC_STEP = (
    1.6  # growth of the non-convexity per round; 1.4 is twice as slow and found the same outliers
)
_LONGEST_TURN_RAD = 0.5  # that clicks may ask for at a time: their linearisation holds no further
_KNOWN, _UNKNOWN = 1e-6, 1e-9  # information, as a share of that in the best known direction


def between(link: Link, inflation: float = 1.0) -> gtsam.NonlinearFactor:
    """The factor of a link, its covariance inflated."""
    noise = gtsam.noiseModel.Gaussian.Covariance(inflation * link.right)
    return gtsam.BetweenFactorPose3(link.a, link.b, gtsam.Pose3(link.T_a_b), noise)


def left_covariance(T_root_node: Floats, right_covariance: Floats) -> Floats:
    """Covariance (6, 6) of left perturbations from gtsam's, which belongs to right ones."""
    A = adjoint(T_root_node)
    return A @ right_covariance @ A.T


@dataclass(frozen=True, eq=False)
class ClickSummary:
    """What all clicks between two keyframes a and b say of T_a_b near a given pose.

    Attributes:
        at: (4, 4) that pose.
        near: whether clicks that are far off there hardly count.
        T_a_b: (4, 4) what they say.
        upper: (6, 6) root of their information on right perturbations, upper triangular.
    """

    at: Floats
    near: bool
    T_a_b: Floats
    upper: Floats


def summed_up(
    clicked: PointPairs, T_a_b: Floats, robust_sigmas: float, near: bool
) -> ClickSummary | None:
    """The Gauss-Newton step of clicked points at a pose, and its information, which need not
    determine all six directions; None where they say nothing.

    A click farther off than `robust_sigmas` counts less, and once the pose is `near` what they say,
    hardly at all.
    """
    off = np.maximum(clicked.distance2(T_a_b) / robust_sigmas**2, 1.0)
    H, g = clicked.normal_equations(T_a_b, weights=off ** (-2.0 if near else -1.0))
    size = max(float(np.abs(clicked.p_a).mean()), 1e-9)  # metres and radians of one scale
    unit = np.repeat((1.0, size), 3)
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    known = values > _KNOWN * values[-1]
    if not (np.isfinite(values).all() and known.any()):
        return None
    along = vectors[:, known]
    step = unit * (along @ ((along.T @ (unit * g)) / values[known]))
    step *= min(1.0, _LONGEST_TURN_RAD / max(float(np.linalg.norm(step[:3])), 1e-12))
    T = retract(T_a_b, step)
    root = np.sqrt(np.maximum(values, _UNKNOWN * values[-1]))[:, None] * (vectors / unit[:, None]).T
    upper = np.asarray(np.linalg.qr(root @ adjoint(T), mode="r"))
    return ClickSummary(T_a_b, near, T, upper)


def click_factor(a: int, b: int, summary: ClickSummary) -> gtsam.NonlinearFactor:
    """All clicks between two keyframes as one factor."""
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(summary.upper)
    return gtsam.BetweenFactorPose3(a, b, gtsam.Pose3(summary.T_a_b), noise)


def prior(node: int, pose: gtsam.Pose3) -> gtsam.NonlinearFactor:
    """Holds a node where it is."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
    return gtsam.PriorFactorPose3(node, pose, noise)


def graph_of(*groups: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """A factor graph of all factors in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for group in groups:
        for factor in group:
            graph.push_back(factor)
    return graph


def values_of(poses: Sequence[Floats]) -> gtsam.Values:
    """Start values: T_root_node per node."""
    values = gtsam.Values()
    for k, T in enumerate(poses):
        values.insert(k, gtsam.Pose3(T))
    return values


def least_squares(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    """Levenberg-Marquardt."""
    return gtsam.LevenbergMarquardtOptimizer(
        graph, start, gtsam.LevenbergMarquardtParams()
    ).optimize()


def poses_in(values: gtsam.Values) -> list[Floats]:
    """(4, 4) pose of each node; nodes are numbered from zero."""
    poses = gtsam.utilities.allPose3s(values)
    return [poses.atPose3(k).matrix() for k in range(poses.size())]


def between_poses(values: gtsam.Values, a: int, b: int) -> Floats:
    """(4, 4) T_a_b of two nodes."""
    return values.atPose3(a).between(values.atPose3(b)).matrix()


def distances2(factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values) -> Floats:
    """Squared Mahalanobis distance of each factor."""
    return np.array([2.0 * factor.error(values) for factor in factors])


def judge(
    factors: Sequence[gtsam.NonlinearFactor],
    known_inliers: Sequence[int],
    held: Sequence[int],
    start: gtsam.Values,
    inlier_probability: float,
) -> npt.NDArray[np.bool_]:
    """Which edges belong together: GNC with truncated least squares (Yang et al. 2020).

    Args:
        factors: of the edges.
        known_inliers: numbers of edges that aren't in question.
        held: one node in each set of nodes that edges connect, kept at its start value.
        start: start values.
        inlier_probability: share of right edges that pass.
    """
    nodes = gtsam.Values()
    for key in graph_of(factors).keyVector():
        nodes.insert(key, start.atPose3(key))
    anchored = [k for k in held if nodes.exists(k)]
    graph = graph_of(factors, (prior(k, nodes.atPose3(k)) for k in anchored))
    parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setLambdaStep(_GNC_STEP)
    parameters.setKnownInliers([*known_inliers, *range(len(factors), graph.size())])
    optimizer = gtsam.GncLMOptimizer(graph, nodes, parameters)
    optimizer.setInlierCostThresholdsAtProbability(inlier_probability)
    optimizer.optimize()
    return np.asarray(optimizer.getWeights())[: len(factors)] > 0.5


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of one solution, made when asked for. One `gtsam.Marginals` per component."""

    number: dict[ViewName, int]
    poses: list[Floats]
    marginals: dict[int, "gtsam.Marginals | str"]
    component: list[int]

    def of(self, node: ViewName) -> tuple[Floats | None, str]:
        """Covariance (6, 6) of T_root_node, or None and the reason."""
        k = self.number[node]
        marginals = self.marginals.get(self.component[k], "not asked for")
        if isinstance(marginals, str):
            return None, marginals
        return left_covariance(self.poses[k], marginals.marginalCovariance(k)), ""

    def relative(self, a: ViewName, b: ViewName) -> Floats | None:
        """Covariance (6, 6) of T_a_b of two nodes of one component, or None: one may be newer."""
        if a not in self.number or b not in self.number:
            return None
        k, m = self.number[a], self.number[b]
        marginals = self.marginals.get(self.component[k], "not asked for")
        if isinstance(marginals, str) or k == m:
            return None if k != m else np.zeros((6, 6))
        joint = marginals.jointMarginalCovariance([k, m])
        T_a_b = inverse(self.poses[k]) @ self.poses[m]
        # T_a_b exp(d) with d = d_b - Ad(T_b_a) d_a
        J = np.concatenate((-adjoint(inverse(T_a_b)), np.eye(6)), axis=1)
        full = np.block([[joint.at(k, k), joint.at(k, m)], [joint.at(m, k), joint.at(m, m)]])
        return left_covariance(T_a_b, J @ full @ J.T)


def marginals_or_reason(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> "gtsam.Marginals | str":
    """Marginals, or why there are none: gtsam raises when something is not determined."""
    try:
        return gtsam.Marginals(graph, values)
    except RuntimeError as error:  # IndeterminantLinearSystemException has no class in Python
        return f"the measurements do not determine it: {str(error).strip().splitlines()[0][:160]}"
