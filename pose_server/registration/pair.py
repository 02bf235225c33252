"""Two views side by side: matches between them, and how well a pose explains both."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.free_space import Agreement, agreement
from fleetpose.pose_server.geometry.features.matching import (
    NO_MATCHES,
    guided_matches,
    one_to_one,
    ratio_matches,
    union,
)
from fleetpose.pose_server.geometry.features.refine import NoiseScale, Refinement, refine
from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class PairSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    ratio: float = 0.9  # distance of the best descriptor over that of the second best
    # of wide sets: with tilted copies the second best is often the same place
    wide_ratio: float = 0.95
    same_pose: float = 0.02  # share of the depth, and radians
    grave_position: float = 0.05  # error of a grave pose, share of the depth
    grave_rotation_rad: float = 0.087  # error of a grave pose, radians: 5 deg
    common_noise: NoiseScale = NoiseScale(1.0, 1.2)  # candidates are compared at the same noise
    own_noise: NoiseScale = NoiseScale(1.0, 1.5)  # of cameras that are what they state
    # across the epipolar line: a wider one is found by chance around any place
    exact_sigmas: float = 2.5
    scored_radius: float = 0.006  # share of the depth


PAIR = in_use("pair", PairSettings())


class Pair:
    """Two views and what every step of their alignment shares.

    Attributes:
        depth_m: median depth of both.
        sigma: relative sigma of the distance of two matching points along the ray.
        ratio_limit: largest distance ratio of their nearest and second nearest.
    """

    def __init__(self, i: PreparedView, j: PreparedView, ratio: float) -> None:
        self.i, self.j, self.ratio_limit = i, j, ratio
        self.depth_m = 0.5 * (i.median_depth_m + j.median_depth_m)
        self.sigma = float(np.hypot(i.surface.depth_sigma, j.surface.depth_sigma))
        self.looks = i.looks and j.looks  # else nothing can be matched by what it looks like
        self.memo: dict[bytes, Any] = {}  # what is known of poses, by whoever found it out
        self._guided: dict[tuple[bytes, float, bool], Indices] = {}

    @cached_property
    def ratio(self) -> Indices:
        """(M, 2) matches by descriptor alone, of points with depth, the most similar first."""
        if not self.looks:
            return NO_MATCHES
        i, j = self.i, self.j
        lifted_i, lifted_j = i.observed.lifted, j.observed.lifted
        looks_i, looks_j = i.descriptors[lifted_i], j.descriptors[lifted_j]
        found, cosines = ratio_matches(looks_i, looks_j, self.ratio_limit)
        found = found[np.argsort(-cosines, kind="stable")]
        return np.column_stack((lifted_i[found[:, 0]], lifted_j[found[:, 1]]))

    def points(self, matches: Indices) -> tuple[Floats, Floats]:
        return self.i.observed.points[matches[:, 0]], self.j.observed.points[matches[:, 1]]

    def refined(
        self,
        T: Floats,
        matches: Indices,
        noise: NoiseScale,
        iterations: int = 6,
        most_pixel_noise: float = 1.0,
    ) -> Refinement:
        """See `refine`; pixels are taken to be no worse than the cameras state."""
        views = self.i.observed, self.j.observed
        return refine(*views, matches, T, noise, iterations, most_pixel_noise=most_pixel_noise)

    def scored(self, T: Floats, matches: Indices, noise: NoiseScale) -> Refinement:
        return refine(self.i.observed, self.j.observed, matches, T, noise, 0)

    def guided(self, T: Floats, radius: float, both_ways: bool = True) -> Indices:
        """Matches around the predicted places of j's points in i, and of i's in j; the radius is a
        share of the depth.
        """
        if not self.looks:
            return NO_MATCHES
        key = T.tobytes(), radius, both_ways  # a pose is looked at by several steps
        known = self._guided.get(key)
        if known is None:
            known = self._guided[key] = self._guided_at(T, radius, both_ways)
        return known

    def _guided_at(self, T: Floats, radius: float, both_ways: bool) -> Indices:
        found = [self._around(self.j, self.i, T, radius)]
        if both_ways:
            matches, cosines = self._around(self.i, self.j, inverse(T), radius)
            found.append((matches[:, ::-1], cosines))
        matches, cosines = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return one_to_one(matches[:, ::-1], cosines)

    def _around(
        self, source: PreparedView, target: PreparedView, T_target_source: Floats, radius: float
    ) -> tuple[Indices, Floats]:
        pixels = max(radius * target.observed.focal_px, 4.0)
        return guided_matches(
            source.observed.predict_in(target.observed, T_target_source, pixels),
            source.descriptors,
            target.observed.grid,
            target.observed.inverse_depth,
            target.descriptors,
            pixels,
            max(0.1, 5 * self.sigma),
        )

    def same_pose(self, a: Floats, b: Floats) -> bool:
        """Whether two poses are one: a start from either leads to the same place."""
        return max(self.apart(a, b)) < PAIR.same_pose

    def gravely_apart(self, a: Floats, b: Floats) -> bool:
        """Whether one of two poses must be gravely off: nearer ones are no rivals."""
        shift, turn_rad = self.apart(a, b)
        return shift > PAIR.grave_position or turn_rad > PAIR.grave_rotation_rad

    def apart(self, a: Floats, b: Floats) -> tuple[float, float]:
        """Distance of two poses' positions as a share of the depth, and the angle between them."""
        shift = float(np.linalg.norm(a[:3, 3] - b[:3, 3])) / self.depth_m
        return shift, rotation_angle(a[:3, :3].T @ b[:3, :3])

    def exact(self, T: Floats, matches: Indices) -> Indices:
        """The matches (M, 2) that agree with a pose at the cameras' own noise, to the pixel across
        the epipolar lines.
        """
        if len(matches) < 3:
            return NO_MATCHES
        try:
            scored = self.scored(T, matches, PAIR.own_noise)
        except DegenerateGeometryError:
            return NO_MATCHES
        return matches[
            scored.inliers & (np.abs(scored.across_px) < PAIR.exact_sigmas * self.pixel_px)
        ]

    @property
    def pixel_px(self) -> float:
        """Sigma of the difference of two matching pixels, as the cameras state it."""
        return float(np.hypot(self.i.observed.pixel_sigma_px, self.j.observed.pixel_sigma_px))

    def support(self, T: Floats, matches: Indices) -> float:
        """How many matches agree with a pose, at a noise level that is the same for all poses."""
        return self.scored(T, matches, PAIR.common_noise).support if len(matches) >= 3 else 0.0

    def agreement(self, T: Floats) -> Agreement:
        return agreement(self.i.surface, self.j.surface, T)

    def score(self, T: Floats) -> float:
        """Consistent matches times surface agreement, at a noise level that is the same for all
        candidates.

        Matches are those by descriptor alone and those around the pose's own predictions: only the
        right pose has many of these to the pixel.
        """
        matches = union(self.ratio, self.guided(T, PAIR.scored_radius))
        support = self.support(T, matches)
        if self.i.dense and self.j.dense:
            support = support**0.5
        seen = self.agreement(T)
        surfaces = max(0.02, seen.mean_agree - max(0.0, seen.through - 0.05))
        return (support + 1.0) * surfaces
