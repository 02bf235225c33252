"""A received view made ready for alignment: decoded, lifted, with search trees built when first
needed.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.features.free_space import Surface
from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.features.shapes import Shapes, shapes_of
from fleetpose.pose_server.geometry.icp import DenseCloud, dense_cloud
from fleetpose.pose_server.geometry.noise import PointNoise
from fleetpose.pose_server.tuned import in_use
from fleetpose.protocol.clouds import decode_salient, points_of, strongest
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import NoiseModel, Salient, View, ViewName

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class PreparedViewSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    dense_points: int = 10000  # from here on a cloud is dense enough for ICP
    cloud_points: int = 20000  # of a dense cloud, used for its surface and for ICP
    sample_points: int = 1000  # points of a cloud that free space and agreement are told by
    matched_points: int = 8000  # salient points, at most: matching takes memory by their square
    coarser: float = 1.4  # resolution of a rough ICP over that of the usual one
    shape_resolution: float = 0.025  # share of the depth
    # of gravity by an accelerometer at rest, where the robot states none
    up_sigma_rad: float = 0.02
    icp_pixels: float = 18.0  # lateral resolution of ICP, in pixels at the median depth
    shaped_points: int = 300  # fewer have no surface whose shape could be told


PREPARED_VIEW = in_use("prepared_view", PreparedViewSettings())


@dataclass(frozen=True)
class MeasuredCloud:
    """Points (N, 3) of a view's cloud, metres, prepared for what compares clouds when first
    needed.
    """

    points: Floats
    resolution_m: float
    _shapes: dict[float, Shapes] = field(default_factory=dict)

    @cached_property
    def for_icp(self) -> DenseCloud:
        """With covariances and a search tree."""
        return dense_cloud(self.points, self.resolution_m)

    @cached_property
    def for_rough_icp(self) -> DenseCloud:
        """The same, coarser."""
        return dense_cloud(self.points, PREPARED_VIEW.coarser * self.resolution_m)

    def shapes(self, depth_m: float) -> Shapes:
        """Of its most telling points, at a resolution that suits a scene of that depth: the same
        for all depths that are alike, so that it is seldom done anew.
        """
        resolution_m = PREPARED_VIEW.shape_resolution * 2 ** (0.5 * round(2 * np.log2(depth_m)))
        if resolution_m not in self._shapes:
            self._shapes[resolution_m] = shapes_of(self.points, resolution_m)
        return self._shapes[resolution_m]


@dataclass(frozen=True)
class PreparedView:
    """One view, ready to be aligned.

    Attributes:
        name: the view.
        observed: its salient points.
        descriptors: (N, D) float32 of unit length.
        surface: its cloud as pixels with depths.
        measured: its cloud as points.
        noise: the camera's stated noise.
        median_depth_m: of the cloud.
        up: (3,) unit vector against gravity in the camera frame, where the robot knows it.
        up_sigma_rad: its sigma.
        looks: whether its salient points have descriptors: a cloud without an image has points at
            which its surface bends most, which tell where something is, not what.
    """

    name: ViewName
    observed: Observed
    descriptors: npt.NDArray[np.float32]
    surface: Surface
    measured: MeasuredCloud
    noise: PointNoise
    median_depth_m: float
    up: Floats | None = None
    up_sigma_rad: float = PREPARED_VIEW.up_sigma_rad
    looks: bool = True
    memo: dict[str, Any] = field(init=False, default_factory=dict)
    """What was found out about the view alone, by who did."""

    def strongest(self, count: int) -> "PreparedView":
        """The same view with its strongest salient points only: enough where two views are nearly
        the same.
        """
        if len(self.descriptors) <= count:
            return self
        o = self.observed
        observed = Observed(
            o.K,
            o.size,
            o.uv[:count],
            o.inverse_depth[:count],
            o.inverse_depth_sigma[:count],
            o.pixel_sigma_px,
        )
        return replace(self, observed=observed, descriptors=self.descriptors[:count])

    @property
    def shaped(self) -> bool:
        """Whether there are enough points for a surface whose shape can be told."""
        return len(self.measured.points) >= PREPARED_VIEW.shaped_points

    @property
    def dense(self) -> bool:
        """Whether ICP makes sense."""
        return len(self.measured.points) >= PREPARED_VIEW.dense_points

    @cached_property
    def point_tree(self) -> cKDTree:
        """Of the lifted salient points, for the regression error."""
        return cKDTree(self.observed.points[self.observed.lifted])

    def with_salient(self, salient: Salient) -> "PreparedView":
        """The same view with another set of salient points.

        Raises:
            CodecError: they are damaged.
        """
        observed, descriptors = _observed(salient, self.observed)
        return replace(self, observed=observed, descriptors=descriptors)


def point_noise(noise: NoiseModel) -> PointNoise:
    """The geometry's noise model of the wire's."""
    return PointNoise(noise.pixel_sigma_px, noise.depth_sigma_m)


def prepare_view(view: View) -> PreparedView:
    """Decodes and prepares a view.

    Raises:
        CodecError: the cloud or the salient points are damaged, or there are no points at all.
    """
    points = points_of(view, PREPARED_VIEW.cloud_points)
    if len(points.xyz) < 10:
        raise CodecError(f"view {view.name} has {len(points.xyz)} points with depth, need 10")
    camera = view.camera
    nothing = np.zeros(0)
    empty = Observed(
        camera.K,
        (camera.width, camera.height),
        np.zeros((0, 2)),
        nothing,
        nothing,
        camera.noise.pixel_sigma_px,
    )
    observed, descriptors = _observed(view.salient, empty)
    noise = point_noise(camera.noise)
    median = float(np.median(points.xyz[:, 2]))
    measured = MeasuredCloud(
        points.xyz, max(PREPARED_VIEW.icp_pixels * median / observed.focal_px, 1e-3 * median)
    )
    looks = view.salient.count > 0
    if not looks:
        observed = _shaped(observed, measured, noise, median)
        descriptors = np.zeros((len(observed.uv), 0), np.float32)
    surface = Surface(
        K=camera.K,
        size=observed.size,
        uv=points.uv,
        z=points.xyz[:, 2],
        sample=_sample(points.xyz, PREPARED_VIEW.sample_points),
        depth_sigma=float(noise.depth_sigma(np.array(median))) / median,
    )
    return PreparedView(
        name=view.name,
        observed=observed,
        descriptors=descriptors,
        surface=surface,
        measured=measured,
        noise=noise,
        median_depth_m=median,
        up=view.up_camera,
        up_sigma_rad=view.up_sigma_rad or PREPARED_VIEW.up_sigma_rad,
        looks=looks,
    )


def _shaped(
    observed: Observed, measured: MeasuredCloud, noise: PointNoise, depth_m: float
) -> Observed:
    """The salient points of a cloud without an image: where its surface bends most; of a few
    points, all of them.
    """
    points = measured.points
    if len(points) >= PREPARED_VIEW.shaped_points:
        points = measured.shapes(depth_m).points
    sigma = float(noise.depth_sigma(np.array(depth_m))) / depth_m
    return observed.with_points(points[points[:, 2] > 0], sigma)


def _observed(salient: Salient, of: Observed) -> tuple[Observed, npt.NDArray[np.float32]]:
    """Salient points as seen by the camera of others, and their descriptors (N, D)."""
    points = strongest(decode_salient(salient), PREPARED_VIEW.matched_points)
    descriptors = points.descriptors.astype(np.float32)
    norms = np.linalg.norm(descriptors, axis=1, keepdims=True)
    observed = replace(
        of,
        uv=points.uv.astype(np.float64),
        inverse_depth=points.inverse_depth.astype(np.float64),
        inverse_depth_sigma=points.inverse_depth_sigma.astype(np.float64),
    )
    return observed, descriptors / np.maximum(norms, 1e-6)


def _sample(points: Floats, count: int) -> Floats:
    if len(points) <= count:
        return points
    return points[np.random.default_rng(1).choice(len(points), count, replace=False)]
