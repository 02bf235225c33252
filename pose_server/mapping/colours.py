"""A colour for each robot."""

import colorsys

import numpy as np
import numpy.typing as npt

_FEW = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd",
        "#8c564b", "#e377c2", "#17becf", "#bcbd22", "#7f7f7f")  # fmt: skip
"""Tableau's ten, made to be told apart; the two that are hardest to see come last."""
_GOLDEN = 0.618034  # turns of the hue: neighbours in a list are never alike, however long it is
_VALUES = (0.85, 0.6)  # in turns, so that hues that come round again look different


def robot_colours(count: int) -> npt.NDArray[np.uint8]:
    """(N, 3) red, green, blue of so many robots."""
    if count <= len(_FEW):
        rows = [tuple(bytes.fromhex(colour[1:])) for colour in _FEW[:count]]
    else:
        rows = [
            tuple(
                round(255 * part)
                for part in colorsys.hsv_to_rgb(k * _GOLDEN % 1.0, 0.85, _VALUES[k % 2])
            )
            for k in range(count)
        ]
    return np.array(rows, np.uint8).reshape(-1, 3)
