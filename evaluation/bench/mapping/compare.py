"""Distances between clouds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.se3 import transform
from fleetpose.pose_server.mapping.located import PlacedView, cloud_of

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Shift:
    """How far poses move points, metres."""

    median_m: float
    p95_m: float


@dataclass(frozen=True)
class Distances:
    """Between a map and the truth, metres: accuracy from the map's points to the nearest true ones,
    completeness the other way.
    """

    accuracy_median_m: float
    accuracy_p95_m: float
    completeness_median_m: float
    completeness_p95_m: float


def compared(made: Floats, true: Floats) -> Distances:
    """Points (N, 3) of a map beside true ones (M, 3), by nearest neighbours."""
    accuracy, _ = cKDTree(true).query(made)
    completeness, _ = cKDTree(made).query(true)
    return Distances(*_median_and_p95(accuracy), *_median_and_p95(completeness))


def moved_by_poses(views: Sequence[PlacedView], righted: Sequence[PlacedView]) -> Shift:
    """How far each point of the views' clouds lies from where it lies with the views at their true
    poses, point by point.
    """
    shifts = []
    for view, right in zip(views, righted, strict=True):
        points = cloud_of(view).points
        both = (transform(one.T_fleet_camera, points) for one in (view, right))
        shifts.append(np.linalg.norm(np.subtract(*both), axis=1))
    return Shift(*_median_and_p95(np.concatenate(shifts)))


def _median_and_p95(distances: Floats) -> tuple[float, float]:
    median, p95 = np.percentile(distances, (50, 95))
    return float(median), float(p95)
