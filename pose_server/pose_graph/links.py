"""Edges as links between numbered nodes, with all that solving needs worked out at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import hat
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.pose_graph.types import Edge, SolveSettings
from fleetpose.protocol.messages import Verdict, ViewName

Floats = npt.NDArray[np.floating]

VERIFIED, CONFIRMED, PLAUSIBLE, CONTESTED = 3, 2, 1, 0
"""An operator confirmed what is no more than plausible: it is believed rather than its rivals."""
VERDICT_OF_RANK: dict[int, Verdict] = {
    VERIFIED: "verified",
    CONFIRMED: "plausible",
    PLAUSIBLE: "plausible",
    CONTESTED: "ambiguous",
}


@dataclass(frozen=True, eq=False)
class Link:
    """A relative pose of nodes a and b, by number.

    Attributes:
        T_a_b: (4, 4) camera b in camera a, and T_b_a.
        left: (6, 6) covariance of T_a_b for left perturbations, `exp(xi) T_a_b`.
        right: (6, 6) the same for right ones, `T_a_b exp(xi)`: gtsam's.
        rank: how far it can be trusted, higher is better.
        size_m: how far it may put the other camera: one number for its uncertainty.
        edge: number of the edge it is made of, or None.
        p_grave: probability that it is gravely off.
        structure: what it rests on, in the frame of node a, where that is known.
    """

    a: int
    b: int
    T_a_b: Floats
    T_b_a: Floats
    left: Floats
    right: Floats
    rank: int
    size_m: float
    edge: int | None = None
    p_grave: float = 0.0
    structure: Structure | None = None

    def reversed(self) -> "Link":
        """The same from b to a: what perturbs T_a_b from the left perturbs T_b_a from the right."""
        return Link(
            self.b,
            self.a,
            self.T_b_a,
            self.T_a_b,
            self.right,
            self.left,
            self.rank,
            self.size_m,
            self.edge,
            self.p_grave,
            None if self.structure is None else self.structure.seen_from(self.T_b_a),
        )


def rank_of(edge: Edge) -> int | None:
    """How far an edge is trusted; None if it is not used at all."""
    if edge.verdict == "verified":
        return VERIFIED
    if edge.operator and edge.verdict in ("plausible", "ambiguous"):
        return CONFIRMED
    return PLAUSIBLE if edge.verdict == "plausible" else None


def joins_alone(edge: Edge) -> bool:
    """Whether one such edge suffices to join two components."""
    usable = rank_of(edge) is not None
    return usable and (edge.verdict == "verified" or edge.operator or edge.kind == "odometry")


def links_of(
    edges: Sequence[Edge], number: Mapping[ViewName, int], settings: SolveSettings
) -> list[Link]:
    """Links of the edges that are used; the floor is added to their covariances at camera b."""
    used = [(k, edge, rank) for k, edge in enumerate(edges) if (rank := rank_of(edge)) is not None]
    if not used:
        return []
    T = np.stack([edge.T_a_b for _, edge, _ in used])
    left = np.stack([edge.covariance for _, edge, _ in used])
    T_inverse, left, right, size = _worked_out(
        T, left, settings.floor_rotation_rad, settings.floor_translation_m
    )
    return [
        Link(
            number[edge.a],
            number[edge.b],
            T[n],
            T_inverse[n],
            left[n],
            right[n],
            rank,
            float(size[n]),
            k,
            edge.p_grave,
            edge.structure,
        )
        for n, (k, edge, rank) in enumerate(used)
    ]


def link(
    a: int, b: int, T_a_b: Floats, covariance: Floats, rank: int, p_grave: float = 0.0
) -> Link:
    """A link that is no edge."""
    T_inverse, left, right, size = _worked_out(T_a_b[None], covariance[None], 0.0, 0.0)
    size_m = float(size[0])
    return Link(a, b, T_a_b, T_inverse[0], left[0], right[0], rank, size_m, None, p_grave)


def _worked_out(
    T: Floats, left: Floats, floor_rotation_rad: float, floor_translation_m: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Inverses (N, 4, 4), left and right covariances (N, 6, 6) with their floor, and sizes (N,)."""
    R, t = T[:, :3, :3], T[:, :3, 3]
    inverse = np.broadcast_to(np.eye(4), T.shape).copy()
    inverse[:, :3, :3] = R.transpose(0, 2, 1)
    inverse[:, :3, 3] = -np.einsum("nji,nj->ni", R, t)
    A, A_inverse = _adjoints(T), _adjoints(inverse)
    right = A_inverse @ left @ A_inverse.transpose(0, 2, 1)
    floor = np.repeat((floor_rotation_rad**2, floor_translation_m**2), 3)
    right = right + np.diag(floor)
    right = (right + right.transpose(0, 2, 1)) / 2
    left = A @ right @ A.transpose(0, 2, 1)
    turn2 = np.trace(right[:, :3, :3], axis1=1, axis2=2)
    shift2 = np.trace(right[:, 3:, 3:], axis1=1, axis2=2)
    return inverse, left, right, np.sqrt(np.maximum(turn2 * (t * t).sum(1) + shift2, 0.0))


def _adjoints(T: Floats) -> Floats:
    A = np.zeros((len(T), 6, 6))
    A[:, :3, :3] = A[:, 3:, 3:] = T[:, :3, :3]
    A[:, 3:, :3] = hat(T[:, :3, 3]) @ T[:, :3, :3]
    return A
