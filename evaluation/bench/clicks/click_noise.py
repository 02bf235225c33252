"""The simulated operator's hand in one pair of views: clicks that can be lifted, some of them
wrong.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.simulate.operator import draw_clicks

WRONG_PX = 50.0
"""How far a wrong click is from the right place, in one of the two images."""
_TRIED_PER_CLICK = 6
_DIRECTIONS = 24

Size = tuple[int, int]
Lift = Callable[[int, Floats], object | None]
"""Lifts a pixel of the first (0) or second (1) view; none where the server would refuse it."""


@dataclass(frozen=True)
class Clicked:
    """Clicks in two views: (N, 2) pixels in each, and (N,) which of them are wrong."""

    pixels: tuple[Floats, Floats]
    wrong: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.wrong)

    def first(self, count: int) -> "Clicked":
        """The first clicks only."""
        return self.only(np.arange(len(self)) < count)

    def only(self, kept: npt.NDArray[np.bool_]) -> "Clicked":
        """Some of the clicks."""
        return Clicked((self.pixels[0][kept], self.pixels[1][kept]), self.wrong[kept])


def right_clicks(
    true: tuple[Floats, Floats],
    count: int,
    rng: np.random.Generator,
    sizes: tuple[Size, Size],
    lift: Lift,
) -> Clicked:
    """Up to `count` true correspondences, far apart, with a hand's noise.

    Where the server refuses a click because there is no depth, the operator takes the next place.

    Args:
        true: (N, 2) pixels of both views that show the same points.
        count: how many.
        rng: of choice and noise.
        sizes: width and height of both images.
        lift: tells what the server takes.
    """
    drawn = draw_clicks(true, count * _TRIED_PER_CLICK, rng, sizes)
    taken: list[tuple[Floats, Floats]] = []
    for click in drawn:
        if len(taken) == count:
            break
        if lift(0, click.pixel_i) is not None and lift(1, click.pixel_j) is not None:
            taken.append((click.pixel_i, click.pixel_j))
    pixels = np.array(taken, np.float64).reshape(-1, 2, 2)
    return Clicked((pixels[:, 0], pixels[:, 1]), np.zeros(len(pixels), bool))


def with_wrong(
    clicked: Clicked, count: int, rng: np.random.Generator, sizes: tuple[Size, Size], lift: Lift
) -> Clicked:
    """The same clicks, `count` of them moved by 50 px in one image, to where there is depth.

    Fewer are wrong where a click has no such place around it in either image.
    """
    pixels = (clicked.pixels[0].copy(), clicked.pixels[1].copy())
    wrong = clicked.wrong.copy()
    for k in rng.permutation(len(clicked)):
        if wrong.sum() == count:
            break
        for view in rng.permutation(2):
            place = _astray(pixels[view][k], rng, sizes[view], lambda p, v=int(view): lift(v, p))
            if place is not None:
                pixels[view][k], wrong[k] = place, True
                break
    return Clicked(pixels, wrong)


def _astray(
    pixel: Floats, rng: np.random.Generator, size: Size, lift: Callable[[Floats], object | None]
) -> Floats | None:
    """A place 50 px away, within the image, that the server takes."""
    first = rng.uniform(0.0, 2 * np.pi)
    for angle in first + 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        place = pixel + WRONG_PX * np.array((np.cos(angle), np.sin(angle)))
        inside = ((place >= 0) & (place <= np.subtract(size, 1))).all()
        if inside and lift(place) is not None:
            return place
    return None


def wrong_of(count: int, share: float) -> int:
    """How many of so many clicks are wrong for a share of them, to the nearest."""
    return int(np.floor(share * count + 0.5))
