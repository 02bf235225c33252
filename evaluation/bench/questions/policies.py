"""Which pair of robots the operator clicks in next."""

from collections import Counter
from collections.abc import Callable

import numpy as np

from fleetpose.evaluation.bench.questions.server import FleetServer, RobotPair, named_pairs
from fleetpose.hmi_client.model.matrix import default_threshold_m, is_shown
from fleetpose.pose_server.messages.builders import pair_cells
from fleetpose.pose_server.questions.facts import questions

Policy = Callable[[FleetServer, Counter[RobotPair], np.random.Generator], RobotPair | None]
"""Picks a pair, given how often each was visited; none if it has nothing to ask."""


def by_questions(
    server: FleetServer, visits: Counter[RobotPair], rng: np.random.Generator
) -> RobotPair | None:
    """The server's first question."""
    del visits, rng
    first = next(iter(questions(server.site)), None)
    return None if first is None else (first.i, first.j)


def by_largest_error(
    server: FleetServer, visits: Counter[RobotPair], rng: np.random.Generator
) -> RobotPair | None:
    """The paper's rule: the pair with the largest regression error that the matrix shows, of those
    visited least: nobody clicks in one pair for ever.
    """
    del rng
    threshold_m = default_threshold_m(server.site.depth_m)
    shown = {
        (cell.i, cell.j): cell.rmse_m or 0.0
        for cell in pair_cells(server.site, 0.0, {})
        if is_shown(cell, threshold_m)
    }
    return max(shown, key=lambda pair: (-visits[pair], shown[pair]), default=None)


def by_chance(
    server: FleetServer, visits: Counter[RobotPair], rng: np.random.Generator
) -> RobotPair | None:
    """Any pair of those visited least."""
    pairs = named_pairs(list(server.views))
    least = min(visits[pair] for pair in pairs)
    some = [pair for pair in pairs if visits[pair] == least]
    return some[int(rng.integers(len(some)))]


POLICIES: dict[str, Policy] = {
    "questions": by_questions,
    "largest_error": by_largest_error,
    "random": by_chance,
}
