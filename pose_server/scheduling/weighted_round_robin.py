"""Whose turn it is: smooth weighted round robin, with weights that grow with the waiting.

Every pick raises each key's credit by its weight and takes their sum from the winner (Nginx's
smooth variant). So shares are proportional to weights, and a key waits for less than
`2 W / w + n` picks: W the sum of all weights, w its own, n the number of keys.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

K = TypeVar("K")

AGE_S = 10.0  # of waiting double a key's weight
OLDEST_S = 60.0  # waiting longer adds no more


@dataclass(frozen=True)
class Pick(Generic[K]):
    """A key whose turn it was.

    Attributes:
        weight, total: its own when it was picked, and the sum of all.
        waited_s: since it was offered or picked last.
        waited_picks: of others in that time.
        most_picks: how many those could have been.
    """

    key: K
    weight: float
    total: float
    waited_s: float
    waited_picks: int
    most_picks: int


class WeightedRoundRobin(Generic[K]):
    """Keys that wait for their turn. Times are of one monotonic clock, in seconds."""

    def __init__(self) -> None:
        self._place: dict[K, int] = {}
        self._keys: list[K] = []
        self._base = np.zeros(16)
        self._credit = np.zeros(16)
        self._since_s = np.zeros(16)
        self._since_pick = np.zeros(16, np.int64)
        self._lightest = np.zeros(16)  # while it waits
        self._picks = 0
        self._most_total = 0.0

    def __len__(self) -> int:
        return len(self._keys)

    def __contains__(self, key: K) -> bool:
        return key in self._place

    def waiting(self) -> list[K]:
        """All keys in line, in no order."""
        return list(self._keys)

    def put(self, key: K, weight: float, now_s: float) -> None:
        """Adds a key, or gives it another weight; it keeps its place in the line.

        Raises:
            ValueError: the weight is not positive.
        """
        if not weight > 0:
            raise ValueError(f"weight {weight} of {key}")
        k = self._place.get(key)
        if k is None:
            k = self._place[key] = len(self._keys)
            self._keys.append(key)
            if k == len(self._base):
                self._grow()
            self._credit[k] = 0.0
            self._wait_anew(k, now_s, weight)
        self._base[k] = weight
        self._lightest[k] = min(self._lightest[k], weight)

    def remove(self, key: K) -> None:
        """Takes a key out of the line, if it is there. What it was ahead or behind is shared."""
        k = self._place.pop(key, None)
        if k is None:
            return
        last, left = len(self._keys) - 1, self._credit[k]
        for column in self._columns():
            column[k] = column[last]
        self._keys[k] = self._keys[last]
        self._keys.pop()
        if k != last:
            self._place[self._keys[k]] = k
        if last:
            self._credit[:last] += left / last

    def pick(self, now_s: float, busy: Collection[K] = ()) -> Pick[K] | None:
        """Whose turn it is; the key stays in line, behind. None if nobody waits who is not busy."""
        n = len(self._keys)
        barred = [place for key in busy if (place := self._place.get(key)) is not None]
        if len(barred) == n:
            return None
        waited_s = np.clip(now_s - self._since_s[:n], 0.0, OLDEST_S)
        weights = self._base[:n] * (1.0 + waited_s / AGE_S)
        total = float(weights.sum())
        self._most_total = max(self._most_total, total)
        self._credit[:n] += weights
        credit = self._credit[:n].copy()
        credit[barred] = -np.inf
        k = int(credit.argmax())
        self._credit[k] -= total
        picked = Pick(
            self._keys[k],
            float(weights[k]),
            total,
            max(now_s - self._since_s[k], 0.0),
            self._picks - int(self._since_pick[k]),
            int(2 * self._most_total / self._lightest[k]) + n,
        )
        self._picks += 1
        self._wait_anew(k, now_s, float(self._base[k]))
        return picked

    def _wait_anew(self, k: int, now_s: float, weight: float) -> None:
        self._since_s[k], self._since_pick[k], self._lightest[k] = now_s, self._picks, weight

    def _columns(self) -> tuple[np.ndarray, ...]:
        return self._base, self._credit, self._since_s, self._since_pick, self._lightest

    def _grow(self) -> None:
        grown = [np.concatenate((column, np.zeros_like(column))) for column in self._columns()]
        self._base, self._credit, self._since_s, self._since_pick, self._lightest = grown
