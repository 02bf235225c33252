"""The usual pipelines for aligning two clouds, with their usual settings, behind one interface.

Clouds are scaled so that a voxel is 5 cm: there the settings are those of their authors' examples
for indoor scans, and KISS-Matcher, which refuses small voxels, runs at any scale.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from evaluation.geometry import Floats, rigid
from protocol.errors import FleetPoseError

VOXEL_M = 0.05
NORMAL_RADIUS_M, NORMAL_NEIGHBOURS = 2 * VOXEL_M, 30
FEATURE_RADIUS_M, FEATURE_NEIGHBOURS = 5 * VOXEL_M, 100
RANSAC_DISTANCE_M = 0.075
RANSAC_POINTS = 3
RANSAC_ITERATIONS, RANSAC_CONFIDENCE = 100_000, 0.999
EDGE_LENGTH_RATIO = 0.9
FGR_DISTANCE_M = VOXEL_M
ICP_DISTANCE_M = VOXEL_M
ICP_ITERATIONS = 30


class PeerMissingError(FleetPoseError):
    """A peer's library cannot be loaded."""


@dataclass(frozen=True)
class Peer:
    """One pipeline. Points are (N, 3), metres scaled to the voxel, in the frame of their view.

    Attributes:
        name: as it is called in the results.
        prepare: from points to the work on one view that all its pairs share; peers with the same
            function share its result.
        align: from the prepared views i and j to T_i_j (4, 4).
        settings: what is used, to be shown beside the results.
        load: loads its library; raises a PeerMissingError where it is not there.
    """

    name: str
    prepare: Callable[[Floats], Any]
    align: Callable[[Any, Any], Floats]
    settings: dict[str, Any]
    load: Callable[[], Any] = lambda: None


@cache
def _open3d() -> Any:
    """Open3D, which takes seconds and a hundred megabytes, hence not before it is used."""
    try:
        import open3d
    except (ImportError, OSError) as error:  # OSError: its wheel leaves libraries to the system
        raise PeerMissingError(
            f"Open3D cannot be loaded ({error}): pip install 'fleetpose[eval]'; "
            "it needs libusb-1.0, libGL and libEGL from the system"
        ) from error
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    open3d.utility.random.seed(0)
    return open3d


@dataclass(frozen=True)
class Open3dView:
    """A thinned cloud with normals, and its FPFH features."""

    cloud: Any
    features: Any


def open3d_view(points: Floats) -> Open3dView:
    """Voxels, normals and FPFH (Rusu et al. 2009) of points (N, 3)."""
    o3d = _open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(VOXEL_M)
    near = o3d.geometry.KDTreeSearchParamHybrid
    cloud.estimate_normals(near(NORMAL_RADIUS_M, NORMAL_NEIGHBOURS))
    features = o3d.pipelines.registration.compute_fpfh_feature(
        cloud, near(FEATURE_RADIUS_M, FEATURE_NEIGHBOURS)
    )
    return Open3dView(cloud, features)


def _point_to_plane(i: Open3dView, j: Open3dView, T_i_j: Floats) -> Floats:
    registration = _open3d().pipelines.registration
    found = registration.registration_icp(
        j.cloud,
        i.cloud,
        ICP_DISTANCE_M,
        T_i_j,
        registration.TransformationEstimationPointToPlane(),
        registration.ICPConvergenceCriteria(max_iteration=ICP_ITERATIONS),
    )
    return np.array(found.transformation)


def ransac_icp(i: Open3dView, j: Open3dView) -> Floats:
    """RANSAC on mutual FPFH matches, then point-to-plane ICP."""
    registration = _open3d().pipelines.registration
    found = registration.registration_ransac_based_on_feature_matching(
        j.cloud,
        i.cloud,
        j.features,
        i.features,
        True,
        RANSAC_DISTANCE_M,
        registration.TransformationEstimationPointToPoint(False),
        RANSAC_POINTS,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(EDGE_LENGTH_RATIO),
            registration.CorrespondenceCheckerBasedOnDistance(RANSAC_DISTANCE_M),
        ],
        registration.RANSACConvergenceCriteria(RANSAC_ITERATIONS, RANSAC_CONFIDENCE),
    )
    return _point_to_plane(i, j, found.transformation)


def fgr_icp(i: Open3dView, j: Open3dView) -> Floats:
    """Fast Global Registration (Zhou et al. 2016), then point-to-plane ICP."""
    registration = _open3d().pipelines.registration
    found = registration.registration_fgr_based_on_feature_matching(
        j.cloud,
        i.cloud,
        j.features,
        i.features,
        registration.FastGlobalRegistrationOption(maximum_correspondence_distance=FGR_DISTANCE_M),
    )
    return _point_to_plane(i, j, found.transformation)


@dataclass(frozen=True)
class KissView:
    """A thinned cloud with covariances and its search tree, and points (N, 3) float32 for KISS."""

    cloud: Any
    tree: Any
    points: Any


def kiss_view(points: Floats) -> KissView:
    """Voxels, covariances and search tree of points (N, 3).

    KISS-Matcher's features are not among it: its interface makes them anew for every pair.
    """
    import small_gicp

    cloud, tree = small_gicp.preprocess_points(points, downsampling_resolution=VOXEL_M)
    # It takes voxels itself, and points one by one: of hundreds of thousands that alone would take
    # longer than all the rest.
    thinned = small_gicp.voxelgrid_sampling(points, downsampling_resolution=0.5 * VOXEL_M)
    return KissView(cloud, tree, thinned.points()[:, :3].astype(np.float32))


def kiss_gicp(i: KissView, j: KissView) -> Floats:
    """KISS-Matcher (Lim et al. 2025) with FasterPFH, then generalised ICP of small_gicp."""
    import kiss_matcher
    import small_gicp

    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(VOXEL_M))
    found = matcher.estimate(j.points, i.points)
    start = rigid(np.array(found.rotation, float), np.array(found.translation, float).ravel())
    refined = small_gicp.align(
        i.cloud,
        j.cloud,
        i.tree,
        start,
        max_correspondence_distance=ICP_DISTANCE_M,
        max_iterations=ICP_ITERATIONS,
    )
    return np.array(refined.T_target_source)


_FPFH_SETTINGS = {
    "voxel_m": VOXEL_M,
    "normal_radius_m": NORMAL_RADIUS_M,
    "normal_neighbours": NORMAL_NEIGHBOURS,
    "fpfh_radius_m": FEATURE_RADIUS_M,
    "fpfh_neighbours": FEATURE_NEIGHBOURS,
}
_ICP_SETTINGS = {"distance_m": ICP_DISTANCE_M, "iterations": ICP_ITERATIONS}

PEERS = (
    Peer(
        "open3d_ransac_icp",
        open3d_view,
        ransac_icp,
        {
            **_FPFH_SETTINGS,
            "ransac": {
                "mutual": True,
                "distance_m": RANSAC_DISTANCE_M,
                "points": RANSAC_POINTS,
                "edge_length_ratio": EDGE_LENGTH_RATIO,
                "iterations": RANSAC_ITERATIONS,
                "confidence": RANSAC_CONFIDENCE,
            },
            "point_to_plane_icp": _ICP_SETTINGS,
        },
        _open3d,
    ),
    Peer(
        "open3d_fgr_icp",
        open3d_view,
        fgr_icp,
        {
            **_FPFH_SETTINGS,
            "fgr": {"distance_m": FGR_DISTANCE_M},
            "point_to_plane_icp": _ICP_SETTINGS,
        },
        _open3d,
    ),
    Peer(
        "kiss_gicp",
        kiss_view,
        kiss_gicp,
        {
            "voxel_m": VOXEL_M,
            "kiss_matcher": "defaults for this voxel, from points at half of it",
            "gicp": _ICP_SETTINGS,
        },
    ),
)
