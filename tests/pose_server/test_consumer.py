"""Whoever acts on verified poses alone never acts on a grave one, whatever else is believed:
aliases that agree with each other, wrong operators, edges that come in any order.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.types import Edge
from tests.pose_server.fleet_makers import edge, position_errors, ring, view

N = 8
TRUTH = ring(N)
NODES = [view(f"r{k}") for k in range(N)]
NEWEST = {node.robot: node for node in NODES}
GRAVE_M = 0.3  # a neighbour on the ring is 2.3 m away, noise of a whole ring 0.1 m

pairs = st.tuples(st.integers(0, N - 1), st.integers(0, N - 1)).filter(lambda p: p[0] < p[1])
kinds = st.sampled_from(["right", "alias", "alias", "confirmed alias", "astray"])


def believed(pair: tuple[int, int], kind: str, shift: int, rng: np.random.Generator) -> Edge:
    """A plausible edge: right, by the world turned around its axis, or anyhow."""
    a, b = pair
    if kind == "right":
        return edge(NODES, TRUTH, a, b, rng, verdict="plausible")
    if kind == "astray":
        return edge(NODES, TRUTH, a, b, rng, verdict="plausible", offset=rng.normal(size=6))
    turned = [TRUTH[k if k < N // 2 else (k + shift) % N] for k in range(N)]
    operator = kind == "confirmed alias"
    return edge(NODES, turned, a, b, rng, verdict="plausible", operator=operator)


@settings(max_examples=120, deadline=None)
@given(
    verified=st.sets(pairs, min_size=1, max_size=10),
    others=st.dictionaries(pairs, kinds, max_size=14),
    shift=st.integers(1, N - 1),
    seed=st.integers(0, 2**16),
    steps=st.integers(1, 4),
)
def test_what_is_called_verified_is_never_grave(verified, others, shift, seed, steps):
    rng = np.random.default_rng(seed)
    edges = [edge(NODES, TRUTH, a, b, rng) for a, b in sorted(verified)]
    edges += [believed(p, k, shift, rng) for p, k in others.items() if p not in verified]
    order = rng.permutation(len(edges))
    solution, arrived = None, []
    for part in np.array_split(order, steps):
        arrived = [*arrived, *(edges[k] for k in part)]
        solution = solve_fleet(NODES, arrived, gauge=NODES[0], newest=NEWEST, previous=solution)
        off_m = position_errors(solution, NODES, TRUTH, 0)
        for k, node in enumerate(NODES):
            pose = solution.nodes[node]
            if pose.root == NODES[0] and pose.verdict == "verified":
                assert off_m[k] < GRAVE_M, (node, off_m[k])
