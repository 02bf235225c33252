"""Which cameras give mirrored images, by which pairs of robots fit only if one of both is mirrored.

A pair that fits as it is says that both cameras are alike, a pair that fits mirrored that they are
not. So robots fall into two kinds; those of the smaller kind flip their images. One pair that fits
mirrored by chance would accuse all who hang together with one of its robots: there must be as many
such pairs as they accuse robots.
"""

from collections import deque
from dataclasses import dataclass, field

from fleetpose.protocol.keys import RobotPair


@dataclass(frozen=True)
class Flipped:
    """Robots whose cameras flip their images, and by how many partners of the other kind each was
    contradicted; where both kinds are as many, nobody can tell which of them does.
    """

    robots: dict[str, int]
    sure: bool


@dataclass
class Mirrors:
    """The newest word on every two robots: whether they fit only mirrored."""

    _pairs: dict[RobotPair, bool] = field(default_factory=dict)

    def note(self, a: str, b: str, mirrored: bool) -> bool:
        """Keeps a word on two robots; returns whether it is a new one."""
        key = (min(a, b), max(a, b))
        before = self._pairs.get(key)
        self._pairs[key] = mirrored
        return before != mirrored

    def forget(self, robot: str) -> None:
        """Drops what was said of a robot: it has another camera now."""
        self._pairs = {pair: said for pair, said in self._pairs.items() if robot not in pair}

    def flipped(self) -> list[Flipped]:
        """Of each group of robots that are related at all, the ones of the smaller kind."""
        found = []
        for kinds in self._groups():
            ones = sorted(robot for robot, kind in kinds.items() if kind)
            others = sorted(robot for robot, kind in kinds.items() if not kind)
            if not ones or not others:
                continue
            fewer, more = sorted((ones, others), key=len)
            against = {robot: self._contradicted(robot, set(more)) for robot in fewer}
            if sum(against.values()) < len(fewer):
                continue
            if len(fewer) < len(more):
                found.append(Flipped({r: by for r, by in against.items() if by}, True))
            else:
                both = against | {robot: self._contradicted(robot, set(fewer)) for robot in more}
                found.append(Flipped(both, False))
        return found

    def _contradicted(self, robot: str, others: set[str]) -> int:
        return sum(
            mirrored and robot in pair and bool(others & set(pair))
            for pair, mirrored in self._pairs.items()
        )

    def _groups(self) -> list[dict[str, bool]]:
        """Robots by the kind that they are of, relative to the first one of their group. Who fits
        as it is is of one kind, whatever single pairs say: before a building that is its own mirror
        image two healthy cameras fit mirrored now and then.
        """
        groups: list[dict[str, bool]] = []
        left = {robot for pair in self._pairs for robot in pair}
        while left:
            kinds: dict[str, bool] = {}
            waiting = deque([(min(left), False)])
            while waiting:
                here, kind = waiting.popleft()
                if here in kinds:
                    continue
                kinds[here] = kind
                for pair, mirrored in self._pairs.items():
                    if here in pair:
                        other = pair[0] if pair[1] == here else pair[1]
                        add = waiting.append if mirrored else waiting.appendleft
                        add((other, kind != mirrored))
            groups.append(kinds)
            left -= set(kinds)
        return groups
