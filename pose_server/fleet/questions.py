"""What to ask the operator: the pair of images where a click is worth most.

The gain of a question is the expected drop of the fleet's mean position sigma per click:

    gain = chance x (sum over robots of sigma now - sigma if it succeeds) / (robots x clicks needed)

A robot that is not joined to the anchor has the sigma of the scene, `unknown_sigma_m`. The chance
that clicking succeeds is the likely overlap of the two images, halved by every failed try and by
every correspondence beyond those that should have sufficed.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pose_server.fleet.types import Edge, FleetSolution
from pose_server.geometry.se3 import position_covariance
from protocol.messages import Question, ViewName

CLICKS_TO_JOIN = 3
_BRIDGE_CHANCE = 0.8  # the machine has an answer already and needs only to be told so
_LEAST_CHANCE = 0.02  # similarity can be wrong
_HOPELESS = 0.1  # below this chance a bridge loses its precedence
_STRANGERS_WORTH = 0.5  # joining two components of which neither holds the anchor
_CLICK_SIGMA_SHARE = 0.02  # of the scene's size: how well three clicks place a robot
_SAME_JOIN_DISCOUNT = 0.5  # for each better question about the same two components
_BRIDGE, _JOIN, _SHARPEN = range(3)


@dataclass(frozen=True)
class PairFacts:
    """What is known about asking for a pair of robots, i < j.

    Attributes:
        view_i, view_j: the views to show.
        similarity: 0 to 1, how likely they see the same.
        correspondences: live ones of this pair.
        failed: tries to align it that were rejected, by machine or operator.
    """

    i: str
    j: str
    view_i: ViewName
    view_j: ViewName
    similarity: float
    correspondences: int = 0
    failed: int = 0


@dataclass(frozen=True)
class _Ask:
    kind: int
    facts: PairFacts
    chance: float
    gain_m: float
    about: frozenset[ViewName]
    reason: str


def rank_questions(
    solution: FleetSolution,
    newest: Mapping[str, ViewName],
    pairs: Iterable[PairFacts],
    unknown_sigma_m: float,
    anchor: str | None = None,
    limit: int = 20,
) -> list[Question]:
    """Questions, best first: lone bridges, then pairs that would join components, then the rest.

    Args:
        solution: of the fleet, with covariances of the newest keyframes.
        newest: newest keyframe of each robot.
        pairs: the pairs that may be asked for.
        unknown_sigma_m: sigma of a robot that nothing joins, e.g. the median depth.
        anchor: robot whose component is the fleet; default: the largest component.
        limit: how many to return.
    """
    known = {robot: view for robot, view in newest.items() if view in solution.nodes}
    if not known:
        return []
    fleet = _Fleet.of(solution, known, anchor, unknown_sigma_m)
    bridges = {
        frozenset((edge.a.robot, edge.b.robot)): edge
        for bridge in reversed(solution.bridges)
        for edge in reversed(bridge.edges)
    }
    asks = [
        fleet.ask(facts, bridges.get(frozenset((facts.i, facts.j))))
        for facts in pairs
        if facts.i in known and facts.j in known
    ]
    asks.sort(key=_precedence)
    return _discounted(asks)[:limit]


def _precedence(ask: _Ask) -> tuple[int, float]:
    return (ask.kind if ask.chance >= _HOPELESS else _SHARPEN, -ask.gain_m)


def _discounted(asks: list[_Ask]) -> list[Question]:
    """Once two components are asked about, other questions about them are worth less."""
    seen: Counter[frozenset[ViewName]] = Counter()
    ranked = []
    for ask in asks:
        discount = 1.0
        if ask.kind != _SHARPEN:
            discount = _SAME_JOIN_DISCOUNT ** seen[ask.about]
            seen[ask.about] += 1
        ranked.append((_precedence(ask)[0], ask.gain_m * discount, ask))
    ranked.sort(key=lambda item: (item[0], -item[1]))
    return [
        Question(
            i=ask.facts.i,
            j=ask.facts.j,
            view_i=ask.facts.view_i,
            view_j=ask.facts.view_j,
            reason=ask.reason,
            gain=gain_m,
        )
        for _, gain_m, ask in ranked
        if gain_m > 0
    ]


@dataclass(frozen=True)
class _Fleet:
    root: dict[str, ViewName]
    sigma_m: dict[str, float]
    home: ViewName
    unknown_sigma_m: float

    @classmethod
    def of(
        cls,
        solution: FleetSolution,
        newest: Mapping[str, ViewName],
        anchor: str | None,
        unknown_sigma_m: float,
    ) -> "_Fleet":
        root = {robot: solution.nodes[view].root for robot, view in newest.items()}
        largest = Counter(root.values()).most_common(1)[0][0]
        sigma = {robot: _sigma(solution, view, unknown_sigma_m) for robot, view in newest.items()}
        return cls(root, sigma, root.get(anchor or "", largest), unknown_sigma_m)

    def ask(self, facts: PairFacts, bridge: Edge | None) -> _Ask:
        about = frozenset((self.root[facts.i], self.root[facts.j]))
        if len(about) == 1:
            return self._sharpen(facts, about)
        lost = self._gained(facts)
        chance = _chance(facts, _BRIDGE_CHANCE if bridge is not None else facts.similarity)
        clicks = max(CLICKS_TO_JOIN - facts.correspondences, 1)
        worth = 1.0 if self.home in about else _STRANGERS_WORTH
        drop = len(lost) * (1 - _CLICK_SIGMA_SHARE) * self.unknown_sigma_m * worth
        gain = chance * drop / (len(self.root) * clicks)
        kind = _JOIN if bridge is None else _BRIDGE
        return _Ask(kind, facts, chance, gain, about, self._joining_reason(facts, bridge, lost))

    def _gained(self, facts: PairFacts) -> list[str]:
        """The robots that joining would bring: those away from home, or the smaller side."""
        sides = [
            [robot for robot, root in self.root.items() if root == self.root[name]]
            for name in (facts.i, facts.j)
            if self.root[name] != self.home
        ]
        return min(sides, key=len)

    def _sharpen(self, facts: PairFacts, about: frozenset[ViewName]) -> _Ask:
        better, worse = sorted((facts.i, facts.j), key=lambda robot: self.sigma_m[robot])
        placed = float(np.hypot(self.sigma_m[better], _CLICK_SIGMA_SHARE * self.unknown_sigma_m))
        drop = max(self.sigma_m[worse] - placed, 0.0)
        chance = _chance(facts, facts.similarity)
        clicks = max(CLICKS_TO_JOIN - facts.correspondences, 1)
        gain = chance * drop / (len(self.root) * clicks)
        reason = (
            f"{worse} is known to {self.sigma_m[worse]:.2g} m, {better} to "
            f"{self.sigma_m[better]:.2g} m: points in both would place {worse} better."
        )
        return _Ask(_SHARPEN, facts, chance, gain, about, reason + _history(facts))

    def _joining_reason(self, facts: PairFacts, bridge: Edge | None, lost: list[str]) -> str:
        names = ", ".join(sorted(lost)[:4]) + (" and others" if len(lost) > 4 else "")
        target = "the fleet" if self.home in (self.root[facts.i], self.root[facts.j]) else "others"
        if bridge is not None:
            text = (
                f"{facts.i} and {facts.j} seem to fit, but nothing confirms it: points in both "
                f"would join {names} to {target}."
            )
        else:
            text = f"Nothing joins {names} to {target} yet; these two images may overlap."
        return text + _history(facts)


def _sigma(solution: FleetSolution, view: ViewName, unknown_sigma_m: float) -> float:
    """Position sigma along the weakest direction, at most that of a robot nothing is known of."""
    pose = solution.nodes[view]
    if pose.covariance is None:
        return unknown_sigma_m
    weakest = np.linalg.eigvalsh(position_covariance(pose.T_root_camera, pose.covariance))[-1]
    return float(min(np.sqrt(max(weakest, 0.0)), unknown_sigma_m))


def _chance(facts: PairFacts, likely: float) -> float:
    wasted = max(facts.correspondences - (CLICKS_TO_JOIN - 1), 0)
    return float(np.clip(likely, _LEAST_CHANCE, 1.0)) * 0.5 ** (facts.failed + wasted)


def _history(facts: PairFacts) -> str:
    parts = []
    if 0 < facts.correspondences < CLICKS_TO_JOIN:
        missing = CLICKS_TO_JOIN - facts.correspondences
        parts.append(
            f" {facts.correspondences} of {CLICKS_TO_JOIN} points are there, {missing} to go."
        )
    elif facts.correspondences:
        parts.append(f" {facts.correspondences} points have not sufficed so far.")
    if facts.failed:
        tries = "once" if facts.failed == 1 else f"{facts.failed} times"
        parts.append(f" Tried {tries} without success.")
    return "".join(parts)
