"""How sure a share over pairs is, when pairs of one view succeed and fail together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

DRAWS = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class SharedPairs:
    """A share with its interval.

    Attributes:
        share: of the pairs; none without pairs.
        low, high: 95 % of the shares of redrawn views lie between. Where all pairs or none are
            counted, redrawing cannot show that it could have been otherwise.
        pairs: how many.
    """

    share: float | None
    low: float | None
    high: float | None
    pairs: int


def share_over_views(
    views: Sequence[tuple[int, int]], flags: Sequence[bool], seed: int = 0
) -> SharedPairs:
    """Share of true flags, with a bootstrap over views.

    Views, not pairs, are drawn with replacement: n views make n (n - 1) / 2 pairs, but give no more
    than n independent looks at the scene. A pair counts as often as both its views were drawn.

    Args:
        views: the two views of each pair.
        flags: one per pair.
        seed: of the draws.
    """
    if not len(flags):
        return SharedPairs(None, None, None, 0)
    names, places = np.unique(np.asarray(views), return_inverse=True)
    i, j = places.reshape(-1, 2).T
    true = np.asarray(flags, float)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), DRAWS)
    weights = drawn[:, i] * drawn[:, j]
    counted = weights.sum(axis=1)
    shares = (weights @ true)[counted > 0] / counted[counted > 0]
    share = float(true.mean())
    if not len(shares):
        return SharedPairs(share, share, share, len(flags))
    low, high = np.quantile(shares, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return SharedPairs(share, min(float(low), share), max(float(high), share), len(flags))
