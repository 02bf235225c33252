"""Parallel projection: lengths across the picture stay true, an ellipsoid becomes an ellipse."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]

_SLANT_DEG = 32.0  # of a view from the side: high enough to see who stands behind whom
_AGREE = 0.5  # length of the mean optical axis from which on all cameras look one way
_ASIDE_DEG = 25.0  # beside the cameras' own direction, so that depth shows


@dataclass(frozen=True)
class Projection:
    """A way to look at the fleet.

    Attributes:
        axes: (3, 3) rows: right and up in the picture, and towards who looks; fleet frame.
    """

    axes: Floats

    def flat(self, points: Floats) -> Floats:
        """(N, 2) places in the picture, metres, of points (N, 3)."""
        return points @ self.axes[:2].T

    def nearness(self, points: Floats) -> Floats:
        """(N,) metres towards who looks."""
        return points @ self.axes[2]

    def ellipse(self, covariance: Floats) -> tuple[float, float, float]:
        """Standard deviations along both axes of the outline of an ellipsoid (3, 3), metres, and
        the angle of the first, degrees.
        """
        values, vectors = np.linalg.eigh(self.axes[:2] @ covariance @ self.axes[:2].T)
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        small, large = np.sqrt(np.maximum(values, 0.0))
        return float(large), float(small), float(angle)


def from_above() -> Projection:
    """North up: x to the right, y up."""
    return Projection(np.eye(3))


def aslant(T_fleet_cameras: Floats) -> Projection:
    """From behind and above the cameras (N, 4, 4), where they look one way; else, as around a
    square, from a corner.
    """
    axis = T_fleet_cameras[:, :3, 2].mean(axis=0)
    azimuth = np.radians(-120.0)
    if np.linalg.norm(axis[:2]) > _AGREE:
        azimuth = np.arctan2(-axis[1], -axis[0]) + np.radians(_ASIDE_DEG)
    slant = np.radians(_SLANT_DEG)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array(
        [np.cos(azimuth) * np.cos(slant), np.sin(azimuth) * np.cos(slant), np.sin(slant)]
    )
    return Projection(np.stack((right, np.cross(towards, right), towards)))
