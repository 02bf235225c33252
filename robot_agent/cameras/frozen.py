"""Whether a live camera still lives: a sensor's noise makes every image another one."""

import logging

import numpy as np
import numpy.typing as npt

log = logging.getLogger(__name__)

Image = npt.NDArray[np.uint8]

LEAST_REPEATS = 3  # a driver that has no new image in time hands out the last one again
LEAST_S = 2.0
_FROZEN = (
    "camera frozen name=%s for_s=%.1f: an eye gives the same image to the last bit, as no sensor "
    "does: check its driver and its cable"
)
_LIVES = "camera gives new images again name=%s frozen_s=%.0f"


class Repeats:
    """For how long a device has given the same image; its log says when that begins and ends.

    Args:
        name: of the robot, for the log.
    """

    def __init__(self, name: str = "") -> None:
        self._name = name
        self._told = False
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
        frozen_s = self._frozen_s(images, at_s)
        if bool(frozen_s) != self._told:
            self._told = bool(frozen_s)
            told = _FROZEN if frozen_s else _LIVES
            log.warning(told, self._name, frozen_s)
        return frozen_s

    def _frozen_s(self, images: tuple[Image, ...], at_s: float) -> float:
        if not any(map(_identical, images, self._last)):
            self._last, self._since_s, self._count = images, at_s, 0
            return 0.0
        self._count += 1
        since_s = at_s - self._since_s
        return since_s if self._count >= LEAST_REPEATS and since_s >= LEAST_S else 0.0


def _identical(a: Image, b: Image) -> bool:
    """Whether two images are the same; what shows nothing at all, as in the dark, tells nothing."""
    return a.shape == b.shape and bool((a == b).all()) and int(a.max()) > int(a.min())
