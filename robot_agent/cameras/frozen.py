"""Whether a live camera still lives: a sensor's noise makes every image another one."""

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]

LEAST_REPEATS = 3  # a driver that has no new image in time hands out the last one again
LEAST_S = 2.0


class Repeats:
    """For how long a device has given the same image."""

    def __init__(self) -> None:
        self._last: tuple[Image, ...] = ()
        self._since_s = 0.0
        self._count = 0

    def frozen_s(self, images: tuple[Image, ...], at_s: float) -> float:
        """How long any of the eyes has been identical to the last bit, s; 0 where none is, or not
        for long enough to be sure.

        Args:
            images: of this moment, of each eye.
            at_s: when, on any clock.
        """
        if not any(map(_identical, images, self._last)):
            self._last, self._since_s, self._count = images, at_s, 0
            return 0.0
        self._count += 1
        since_s = at_s - self._since_s
        return since_s if self._count >= LEAST_REPEATS and since_s >= LEAST_S else 0.0


def _identical(a: Image, b: Image) -> bool:
    """Whether two images are the same; what shows nothing at all, as in the dark, tells nothing."""
    return a.shape == b.shape and bool((a == b).all()) and int(a.max()) > int(a.min())
