"""The fleet's keyframes, edges and clicks as a gtsam factor graph, and what gtsam can do with it.

gtsam perturbs a pose from the right, `T exp(xi)`, rotation first; here covariances belong to left
perturbations. The adjoint turns one into the other. A click is a landmark seen by bearing and range
from both cameras: tight across the ray, loose along it, which is how a lifted pixel is known.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from pose_server.fleet.links import Link
from pose_server.fleet.types import ClickFactor
from pose_server.geometry.se3 import adjoint, inverse, transform
from protocol.messages import ViewName

Floats = npt.NDArray[np.floating]

_GAUGE_SIGMA = 1e-6
_LANDMARK = "l"
_GNC_STEP = (
    1.6  # growth of the non-convexity per round; 1.4 is twice as slow and found the same outliers
)
_MIN_BEARING_SIGMA_RAD, _MIN_RANGE_SIGMA = 1e-5, 1e-6


def between(link: Link) -> gtsam.NonlinearFactor:
    """The factor of a link."""
    noise = gtsam.noiseModel.Gaussian.Covariance(link.right)
    return gtsam.BetweenFactorPose3(link.a, link.b, gtsam.Pose3(link.T_a_b), noise)


def left_covariance(T_root_node: Floats, right_covariance: Floats) -> Floats:
    """Covariance (6, 6) of left perturbations from gtsam's, which belongs to right ones."""
    A = adjoint(T_root_node)
    return A @ right_covariance @ A.T


def click_factors(
    clicks: Sequence[tuple[int, int, ClickFactor]], robust_sigmas: float
) -> list[gtsam.NonlinearFactor]:
    """The two sightings of each click's landmark."""
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(robust_sigmas)
    return [
        gtsam.BearingRangeFactor3D(
            node,
            gtsam.symbol(_LANDMARK, k),
            gtsam.Unit3(p),
            float(np.linalg.norm(p)),
            gtsam.noiseModel.Robust.Create(
                cauchy, gtsam.noiseModel.Diagonal.Sigmas(_ray_sigmas(p, C))
            ),
        )
        for k, (a, b, click) in enumerate(clicks)
        for node, p, C in ((a, click.p_a, click.C_a), (b, click.p_b, click.C_b))
    ]


def _ray_sigmas(p: Floats, C: Floats) -> Floats:
    """Sigmas of bearing (two, rad) and range (m); across the ray the noise is taken as round."""
    distance = float(np.linalg.norm(p))
    ray = p / distance
    along = float(ray @ C @ ray)
    across = (float(np.trace(C)) - along) / 2 / distance**2
    bearing = max(np.sqrt(max(across, 0.0)), _MIN_BEARING_SIGMA_RAD)
    reach = max(np.sqrt(max(along, 0.0)), _MIN_RANGE_SIGMA * distance)
    return np.array([bearing, bearing, reach])


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


def values_of(
    poses: Sequence[Floats], clicks: Sequence[tuple[int, int, ClickFactor]]
) -> gtsam.Values:
    """Start values: T_root_node per node, and each landmark where its first camera sees it."""
    values = gtsam.Values()
    for k, T in enumerate(poses):
        values.insert(k, gtsam.Pose3(T))
    for k, (a, _, click) in enumerate(clicks):
        values.insert(gtsam.symbol(_LANDMARK, k), transform(poses[a], click.p_a[None])[0])
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
        """Covariance (6, 6) of T_a_b of two nodes of one component, or None."""
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
