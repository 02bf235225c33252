"""Which pair is next: smooth weighted round robin over pairs of robots.

Every pick raises each pair's credit by its weight and takes the sum from the winner (Nginx's
smooth variant), so that shares are proportional to weights and no pair with a positive weight
starves.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

K = TypeVar("K")

_JOINED_NEED = 0.15
_LEAST_LIKENESS = 0.05  # looks deceive: no pair is hopeless


@dataclass
class RoundRobin(Generic[K]):
    """Smooth weighted round robin with weights that may change between picks."""

    _credit: dict[K, float] = field(default_factory=dict)

    def pick(self, weights: Mapping[K, float]) -> K | None:
        """The next key among those with a positive weight; None if there is none."""
        live = {key: weight for key, weight in weights.items() if weight > 0}
        self._credit = {key: self._credit.get(key, 0.0) for key in live}
        if not live:
            return None
        for key, weight in live.items():
            self._credit[key] += weight
        winner = max(live, key=lambda key: self._credit[key])
        self._credit[winner] -= sum(live.values())
        return winner


def pair_weight(waited_s: float, likeness: float, joined: bool, edges: int) -> float:
    """How much a pair of robots deserves the next alignment.

    Args:
        waited_s: since its last alignment.
        likeness: how alike the most promising untried views look, 0 to 1.
        joined: whether the two already share a component: joining the fleet comes first.
        edges: accepted alignments between them so far.
    """
    need = _JOINED_NEED / (1.0 + edges) if joined else 1.0
    return (_LEAST_LIKENESS + likeness) * need * (1.0 + min(waited_s, 60.0) / 10.0)
