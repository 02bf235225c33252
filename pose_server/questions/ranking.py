"""What to ask the operator: the pair of images where a click is worth most.

The gain of a question is the expected drop of the fleet's mean position sigma per click:

    gain = chance x (sum over robots of sigma now - sigma if it succeeds) / (robots x clicks)

A robot that is not joined to the anchor has the sigma of the scene, `unknown_sigma_m`; so has one
whose links contradict each other, or are too likely gravely off. Clicks are those that are missing
if the operator finds points to click, and a few that looking in vain is worth if not. The chance
that clicking succeeds is halved by every failed try and by every correspondence beyond those that
should have sufficed; where an operator looked and clicked nothing there is next to none.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fleetpose.pose_server.geometry.se3 import position_covariance
from fleetpose.pose_server.pose_graph.types import Edge, FleetSolution
from fleetpose.protocol.messages import Question, ViewName

CLICKS_TO_JOIN = 3
_CLICKS_IN_VAIN = 2  # what looking at two images without finding anything costs
_LEAST_CHANCE = 0.001  # nothing is known so surely
_STILL_THERE = 0.05  # that there is something to click where an operator found nothing
_SEEN_BEFORE = 0.9  # that more can be clicked where something was
_ENOUGH = 0.8  # of each further three points in a pair: they tell less and less
_BEYOND_VERIFIED = 0.05  # that clicks are better than a verified alignment
_LIKELY = 0.5  # from this chance on a bridge comes first
_STRANGERS_WORTH = 0.5  # joining two components of which neither holds the anchor
_CLICK_SIGMA_SHARE = 0.03  # of the scene's size: how well three clicks place a robot
_SAME_JOIN_DISCOUNT = 0.5  # for each better question about the same two components
_NEGLIGIBLE = 1e-7  # gain, share of the scene's size
_BRIDGE, _JOIN, _LOCATE, _SHARPEN = range(4)


@dataclass(frozen=True)
class PairFacts:
    """What is known about asking for a pair of robots, i < j.

    Attributes:
        view_i, view_j: the views to show.
        chance: 0 to 1, how likely they share enough to click.
        correspondences: live ones of this pair.
        failed: tries to align it by the operator's clicks that were rejected.
        in_vain: times that an operator looked at it and clicked nothing.
        fruitless: sets of three clicks in it that did far less than was expected.
        verified: whether an alignment of the pair is verified: clicks add nothing to it.
        why: in words, what the chance is taken from.
    """

    i: str
    j: str
    view_i: ViewName
    view_j: ViewName
    chance: float
    correspondences: int = 0
    failed: int = 0
    in_vain: int = 0
    fruitless: int = 0
    verified: bool = False
    why: str = ""


@dataclass(frozen=True)
class FleetUncertainty:
    """How well a fleet is known: mean position sigma over its robots, and those that are joined to
    the anchor.
    """

    mean_sigma_m: float
    joined: frozenset[str]


@dataclass(frozen=True)
class _Ask:
    """A question; of one kind those of more worth come first.

    Attributes:
        worth_m: the gain, of robots that are not located yet where there are such.
    """

    kind: int
    facts: PairFacts
    chance: float
    gain_m: float
    about: frozenset[ViewName]
    reason: str
    worth_m: float


def rank_questions(
    solution: FleetSolution,
    newest: Mapping[str, ViewName],
    pairs: Iterable[PairFacts],
    unknown_sigma_m: float,
    anchor: str | None = None,
    limit: int = 20,
    located_sigma: float = 0.05,
    located_grave: float = 0.05,
) -> list[Question]:
    """Questions, best first: likely bridges, then pairs that would join components, then those
    about robots that are joined but too unsure to be located, then the rest.

    Args:
        solution: of the fleet, with covariances of the newest keyframes.
        newest: newest keyframe of each robot.
        pairs: the pairs that may be asked for.
        unknown_sigma_m: sigma of a robot that nothing joins, e.g. the median depth.
        anchor: robot whose component is the fleet; default: the largest component.
        limit: how many to return.
        located_sigma: from which sigma on a robot does not count as located, share of
            `unknown_sigma_m`.
        located_grave: from which probability of being gravely off on it does not either.
    """
    known = {robot: view for robot, view in newest.items() if view in solution.nodes}
    if not known:
        return []
    fleet = _Fleet.of(solution, known, anchor, unknown_sigma_m, located_sigma, located_grave)
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
    return _discounted(asks, unknown_sigma_m)[:limit]


def standing(
    solution: FleetSolution,
    newest: Mapping[str, ViewName],
    unknown_sigma_m: float,
    anchor: str | None = None,
) -> FleetUncertainty:
    """How well a fleet is known now; the arguments are those of `rank_questions`."""
    known = {robot: view for robot, view in newest.items() if view in solution.nodes}
    if not known:
        return FleetUncertainty(unknown_sigma_m, frozenset())
    fleet = _Fleet.of(solution, known, anchor, unknown_sigma_m)
    joined = frozenset(robot for robot, root in fleet.root.items() if root == fleet.home)
    sigmas = [fleet.sigma_m[robot] if robot in joined else unknown_sigma_m for robot in newest]
    return FleetUncertainty(float(np.mean(sigmas)), joined)


def _precedence(ask: _Ask) -> tuple[int, float]:
    kind = _JOIN if ask.kind == _BRIDGE and ask.chance < _LIKELY else ask.kind
    return (kind, -ask.worth_m)


def _discounted(asks: list[_Ask], unknown_sigma_m: float) -> list[Question]:
    """Once two components are asked about, other questions about them are worth less."""
    seen: Counter[frozenset[ViewName]] = Counter()
    ranked = []
    for ask in asks:
        discount = 1.0
        if ask.kind in (_BRIDGE, _JOIN):
            discount = _SAME_JOIN_DISCOUNT ** seen[ask.about]
            seen[ask.about] += 1
        kind, worth = _precedence(ask)
        ranked.append(((kind, worth * discount), ask.gain_m * discount, ask))
    ranked.sort(key=lambda item: item[0])
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
        if gain_m > _NEGLIGIBLE * unknown_sigma_m
    ]


@dataclass(frozen=True)
class _Fleet:
    root: dict[str, ViewName]
    sigma_m: dict[str, float]
    behind: dict[str, set[str]]
    home: ViewName
    unknown_sigma_m: float
    located_sigma_m: float
    grave: dict[str, float]

    @classmethod
    def of(
        cls,
        solution: FleetSolution,
        newest: Mapping[str, ViewName],
        anchor: str | None,
        unknown_sigma_m: float,
        located_sigma: float = 0.0,
        located_grave: float = 1.0,
    ) -> "_Fleet":
        root = {robot: solution.nodes[view].root for robot, view in newest.items()}
        largest = Counter(root.values()).most_common(1)[0][0]
        sigma = {robot: _sigma(solution, view, unknown_sigma_m) for robot, view in newest.items()}
        grave = {
            robot: p_grave
            for robot, view in newest.items()
            if (p_grave := solution.nodes[view].p_grave) > located_grave
        }
        sigma |= dict.fromkeys(grave, unknown_sigma_m)
        behind = _behind(solution, newest)
        home = root.get(anchor or "", largest)
        limit_m = located_sigma * unknown_sigma_m
        return cls(root, sigma, behind, home, unknown_sigma_m, limit_m, grave)

    def ask(self, facts: PairFacts, bridge: Edge | None) -> _Ask:
        about = frozenset((self.root[facts.i], self.root[facts.j]))
        if len(about) == 1:
            return self._sharpen(facts, about)
        lost = self._gained(facts)
        worth = 1.0 if self.home in about else _STRANGERS_WORTH
        drop = len(lost) * (1 - _CLICK_SIGMA_SHARE) * self.unknown_sigma_m * worth
        missing = max(CLICKS_TO_JOIN - facts.correspondences, 1)
        chance, gain = self._gain(_chance(facts), missing, drop)
        kind = _JOIN if bridge is None else _BRIDGE
        reason = self._joining_reason(facts, bridge, lost)
        return _Ask(kind, facts, chance, gain, about, reason, gain)

    def _gain(self, chance: float, missing: int, drop: float) -> tuple[float, float]:
        clicks = chance * missing + (1 - chance) * min(_CLICKS_IN_VAIN, missing)
        return chance, chance * drop / (len(self.root) * clicks)

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
        before, known = self.sigma_m[worse], self.sigma_m[better]
        # as if one hung behind the other: what both share no points in them can tell
        between = before**2 - known**2
        clicked = (_CLICK_SIGMA_SHARE * self.unknown_sigma_m) ** 2
        gone = between**2 / (between + clicked) if between > 0 else 0.0
        drops = {
            robot: self.sigma_m[robot] - float(np.sqrt(max(self.sigma_m[robot] ** 2 - gone, 0.0)))
            for robot in (worse, *self.behind[worse])
        }
        unsure = {robot for robot in drops if self.sigma_m[robot] > self.located_sigma_m}
        chance, gain = self._gain(_chance_of_more(facts), CLICKS_TO_JOIN, sum(drops.values()))
        urgent = sum(drop for robot, drop in drops.items() if robot in unsure or not unsure)
        reason = (
            f"{worse} is known to {before:.2g} m, {better} to {known:.2g} m: "
            f"points in both would place {worse} better."
        )
        if worse in self.grave:
            reason = (
                f"{worse} hangs by doubtful links, gravely wrong with a probability of "
                f"{self.grave[worse]:.0%}: points in both would make sure. {facts.why}"
            )
        kind = _LOCATE if unsure else _SHARPEN
        worth = self._gain(chance, CLICKS_TO_JOIN, urgent)[1]
        return _Ask(kind, facts, chance, gain, about, reason + _history(facts), worth)

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
        return text + (f" {facts.why}" if facts.why else "") + _history(facts)


def _sigma(solution: FleetSolution, view: ViewName, unknown_sigma_m: float) -> float:
    """Position sigma along the weakest direction, at most that of a robot nothing is known of."""
    pose = solution.nodes[view]
    if pose.covariance is None or pose.verdict == "ambiguous":
        return unknown_sigma_m
    weakest = np.linalg.eigvalsh(position_covariance(pose.T_root_camera, pose.covariance))[-1]
    return float(min(np.sqrt(max(weakest, 0.0)), unknown_sigma_m))


def _behind(solution: FleetSolution, newest: Mapping[str, ViewName]) -> dict[str, set[str]]:
    """The robots whose way to the root of their component leads through a robot."""
    behind: dict[str, set[str]] = {robot: set() for robot in newest}
    for robot, view in newest.items():
        parent = solution.nodes[view].parent
        while parent is not None:
            if parent.robot != robot and parent.robot in behind:
                behind[parent.robot].add(robot)
            parent = solution.nodes[parent].parent
    return behind


def _chance(facts: PairFacts) -> float:
    """That three clicks in all join two components."""
    wasted = max(facts.correspondences - (CLICKS_TO_JOIN - 1), 0)
    chance = facts.chance * 0.5 ** (facts.failed + wasted) * _STILL_THERE**facts.in_vain
    return float(np.clip(chance, _LEAST_CHANCE, 1.0))


def _chance_of_more(facts: PairFacts) -> float:
    """That three more clicks tell more of two robots that are joined."""
    seen = max(facts.chance, _SEEN_BEFORE if facts.correspondences else 0.0)
    sets = facts.correspondences // CLICKS_TO_JOIN
    chance = seen * _ENOUGH**sets * 0.5**facts.failed * _STILL_THERE**facts.in_vain
    chance *= 0.5**facts.fruitless * (_BEYOND_VERIFIED if facts.verified else 1.0)
    return float(np.clip(chance, _LEAST_CHANCE, 1.0))


def _history(facts: PairFacts) -> str:
    parts = []
    if 0 < facts.correspondences < CLICKS_TO_JOIN:
        missing = CLICKS_TO_JOIN - facts.correspondences
        parts.append(
            f" {facts.correspondences} of {CLICKS_TO_JOIN} points are there, {missing} to go."
        )
    elif facts.correspondences:
        parts.append(f" {facts.correspondences} points have not sufficed so far.")
    if facts.in_vain:
        times = "once" if facts.in_vain == 1 else f"{facts.in_vain} times"
        parts.append(f" Looked at {times} without a click.")
    if facts.failed:
        tries = "once" if facts.failed == 1 else f"{facts.failed} times"
        parts.append(f" Tried {tries} without success.")
    return "".join(parts)
