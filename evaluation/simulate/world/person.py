"""Somebody who walks to and fro on the square, as high as a person and with a pattern on."""

import numpy as np

from fleetpose.evaluation.simulate.world.materials.facades import poster
from fleetpose.evaluation.simulate.world.render import Floats, Quad

_SIZE_M = (0.55, 0.4, 1.75)  # across the way they look, along it, upright
_RADIUS_M = 5.9  # from the middle of the square: nothing else is there
_REACH_DEG = 14.0
_PERIOD_S = 9.7  # so at most 1 m/s; never in step with a camera of a whole rate
_PX_PER_M = 160.0


class Person:
    """A box in patterned clothes that walks along an arc around the middle of the square.

    Args:
        azimuth_deg: where the arc has its middle, seen from the middle of the square.
    """

    def __init__(self, azimuth_deg: float) -> None:
        self._azimuth_deg = azimuth_deg
        rng = np.random.default_rng(7)
        across, along, height = _SIZE_M
        rows = round(height * _PX_PER_M / 4)
        self._textures = [
            np.vstack([poster(rng, rows, round(w * _PX_PER_M)) for _ in range(4)]).astype(np.uint8)
            for w in (across, along, across, along)
        ]

    def quads(self, t_s: float) -> list[Quad]:
        """The four sides (world, metres), t seconds after the start."""
        swing = _REACH_DEG * np.sin(2 * np.pi * t_s / _PERIOD_S)
        azimuth = np.radians(self._azimuth_deg + swing)
        outward = np.array((np.cos(azimuth), np.sin(azimuth), 0.0))
        middle = _RADIUS_M * outward
        sides = []
        for k, texture in enumerate(self._textures):
            width, depth = (_SIZE_M[0], _SIZE_M[1]) if k % 2 == 0 else (_SIZE_M[1], _SIZE_M[0])
            turn = azimuth + k * np.pi / 2
            normal: Floats = np.array((np.cos(turn), np.sin(turn), 0.0))
            right: Floats = np.array((-normal[1], normal[0], 0.0))
            corner = middle + 0.5 * depth * normal - 0.5 * width * right
            corner[2] = _SIZE_M[2]
            sides.append(Quad(corner, width * right, np.array((0.0, 0.0, -_SIZE_M[2])), texture))
        return sides
