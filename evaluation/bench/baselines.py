"""The usual pipelines for aligning two views, with their authors' settings, behind one interface.

Clouds are scaled so that a voxel is 5 cm: there the settings are those of their authors' examples
for indoor scans, and KISS-Matcher, which refuses small voxels, runs at any scale. Those of Open3D
are of its tutorial on global registration (open3d.org, pipelines/global_registration): the clouds
are thinned for features, RANSAC takes 1.5 voxels and FGR half a voxel, and point-to-plane ICP works
on the clouds as they came, at 0.4 voxels. Who can use images gets the images.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats, rigid
from fleetpose.protocol.errors import FleetPoseError

VOXEL_M = 0.05
NORMAL_RADIUS_M, NORMAL_NEIGHBOURS = 2 * VOXEL_M, 30
FEATURE_RADIUS_M, FEATURE_NEIGHBOURS = 5 * VOXEL_M, 100
RANSAC_DISTANCE_M = 0.075
RANSAC_POINTS = 3
RANSAC_ITERATIONS, RANSAC_CONFIDENCE = 100_000, 0.999
EDGE_LENGTH_RATIO = 0.9
FGR_DISTANCE_M = 0.5 * VOXEL_M
ICP_DISTANCE_M = 0.4 * VOXEL_M
GICP_DISTANCE_M = VOXEL_M
ICP_ITERATIONS = 30
MATCH_RATIO = 0.75
"""Of OpenCV's tutorial on feature matching."""
DEPTH_WITHIN_PX = 2
"""A keypoint has the depth of its pixel, or of one so near where only some pixels have depth."""


class PeerMissingError(FleetPoseError):
    """A peer's library cannot be loaded."""


@dataclass(frozen=True)
class Sight:
    """All that a robot's camera gave of one view.

    Attributes:
        points: (N, 3) metres scaled to the voxel, in the frame of the view.
        uv: (N, 2) their pixels.
        image: (H, W, 3) or (H, W), as the camera took it.
    """

    points: Floats
    uv: Floats
    image: npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Peer:
    """One pipeline.

    Attributes:
        name: as it is called in the results.
        prepare: the work on one view that all its pairs share; peers with the same function share
            its result.
        align: from the prepared views i and j to T_i_j (4, 4).
        settings: what is used, to be shown beside the results.
        load: loads its library; raises a PeerMissingError where it is not there.
        needs_images: whether clouds alone are not enough.
    """

    name: str
    prepare: Callable[[Sight], Any]
    align: Callable[[Any, Any], Floats]
    settings: dict[str, Any]
    load: Callable[[], Any] = lambda: None
    needs_images: bool = False


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
    """A cloud with normals as it came, thinned with normals, and the FPFH features of that."""

    whole: Any
    cloud: Any
    features: Any


def open3d_view(sight: Sight) -> Open3dView:
    """Voxels, normals and FPFH (Rusu et al. 2009) of a cloud."""
    o3d = _open3d()
    whole = _with_normals(sight.points)
    near = o3d.geometry.KDTreeSearchParamHybrid
    cloud = whole.voxel_down_sample(VOXEL_M)
    cloud.estimate_normals(near(NORMAL_RADIUS_M, NORMAL_NEIGHBOURS))
    features = o3d.pipelines.registration.compute_fpfh_feature(
        cloud, near(FEATURE_RADIUS_M, FEATURE_NEIGHBOURS)
    )
    return Open3dView(whole, cloud, features)


def _with_normals(points: Floats) -> Any:
    o3d = _open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    near = o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS_M, NORMAL_NEIGHBOURS)
    cloud.estimate_normals(near)
    return cloud


def _point_to_plane(i: Any, j: Any, T_i_j: Floats) -> Floats:
    registration = _open3d().pipelines.registration
    plane = registration.TransformationEstimationPointToPlane()
    until = registration.ICPConvergenceCriteria(max_iteration=ICP_ITERATIONS)
    found = registration.registration_icp(j, i, ICP_DISTANCE_M, T_i_j, plane, until)
    return np.array(found.transformation)


def _ransac_settings() -> tuple[Any, ...]:
    """What both of Open3D's RANSACs take last."""
    registration = _open3d().pipelines.registration
    return (
        RANSAC_DISTANCE_M,
        registration.TransformationEstimationPointToPoint(False),
        RANSAC_POINTS,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(EDGE_LENGTH_RATIO),
            registration.CorrespondenceCheckerBasedOnDistance(RANSAC_DISTANCE_M),
        ],
        registration.RANSACConvergenceCriteria(RANSAC_ITERATIONS, RANSAC_CONFIDENCE),
    )


def ransac_icp(i: Open3dView, j: Open3dView) -> Floats:
    """RANSAC on mutual FPFH matches, then point-to-plane ICP."""
    ransac = _open3d().pipelines.registration.registration_ransac_based_on_feature_matching
    found = ransac(j.cloud, i.cloud, j.features, i.features, True, *_ransac_settings())
    return _point_to_plane(i.whole, j.whole, found.transformation)


def fgr_icp(i: Open3dView, j: Open3dView) -> Floats:
    """Fast Global Registration (Zhou et al. 2016), then point-to-plane ICP."""
    registration = _open3d().pipelines.registration
    option = registration.FastGlobalRegistrationOption
    found = registration.registration_fgr_based_on_feature_matching(
        *(j.cloud, i.cloud, j.features, i.features),
        option(maximum_correspondence_distance=FGR_DISTANCE_M),
    )
    return _point_to_plane(i.whole, j.whole, found.transformation)


@dataclass(frozen=True)
class SiftView:
    """A cloud with normals, and the keypoints that have a depth: places (N, 3), descriptors."""

    cloud: Any
    places: Floats
    descriptors: npt.NDArray[np.float32]


def sift_view(sight: Sight) -> SiftView:
    """SIFT (Lowe 2004) of the image by OpenCV's defaults; a keypoint has the depth of its pixel."""
    import cv2

    keypoints, descriptors = cv2.SIFT_create().detectAndCompute(sight.image, None)
    if descriptors is None:
        descriptors = np.zeros((0, 128), np.float32)
    at = points_at(sight, np.array([one.pt for one in keypoints], float).reshape(-1, 2))
    places = sight.points[at[at >= 0]]
    return SiftView(_with_normals(sight.points), places, descriptors[at >= 0])


def points_at(sight: Sight, pixels: Floats) -> npt.NDArray[np.int64]:
    """(N,) index of the point that a pixel (N, 2) shows, -1 where there is none near."""
    import cv2

    size = np.array(sight.image.shape[1::-1])
    number = np.full(size[::-1], -1.0, np.float32)
    columns, rows = np.clip(sight.uv.round().astype(int), 0, size - 1).T
    number[rows, columns] = np.arange(len(sight.points))
    near = cv2.dilate(number, np.ones((2 * DEPTH_WITHIN_PX + 1,) * 2, np.uint8))
    number = np.where(number < 0, near, number)
    columns, rows = np.clip(pixels.round().astype(int), 0, size - 1).T
    return number[rows, columns].astype(np.int64)


def sift_ransac_icp(i: SiftView, j: SiftView) -> Floats:
    """What is written first with OpenCV and Open3D: matches by the ratio test, RANSAC on three of
    their points, then point-to-plane ICP. The identity where there are too few matches.
    """
    o3d = _open3d()
    matches = _ratio_matches(j.descriptors, i.descriptors)
    start = np.eye(4)
    if len(matches) >= RANSAC_POINTS:
        at_j, at_i = (
            o3d.geometry.PointCloud(o3d.utility.Vector3dVector(view.places)) for view in (j, i)
        )
        pairs = o3d.utility.Vector2iVector(matches)
        ransac = o3d.pipelines.registration.registration_ransac_based_on_correspondence
        start = ransac(at_j, at_i, pairs, *_ransac_settings()).transformation
    return _point_to_plane(i.cloud, j.cloud, start)


def _ratio_matches(
    queries: npt.NDArray[np.float32], targets: npt.NDArray[np.float32]
) -> npt.NDArray[np.int32]:
    """(M, 2) indices of descriptors whose nearest one is clearly nearer than the second."""
    import cv2

    if len(queries) == 0 or len(targets) < 2:
        return np.zeros((0, 2), np.int32)
    both = cv2.BFMatcher(cv2.NORM_L2).knnMatch(queries, targets, k=2)
    clear = [best for best, second in both if best.distance < MATCH_RATIO * second.distance]
    return np.array([(one.queryIdx, one.trainIdx) for one in clear], np.int32).reshape(-1, 2)


@dataclass(frozen=True)
class KissView:
    """A thinned cloud with covariances and its search tree, and points (N, 3) float32 for KISS."""

    cloud: Any
    tree: Any
    points: Any


def kiss_view(sight: Sight) -> KissView:
    """Voxels, covariances and search tree of a cloud.

    KISS-Matcher's features are not among it: its interface makes them anew for every pair.
    """
    import small_gicp

    cloud, tree = small_gicp.preprocess_points(sight.points, downsampling_resolution=VOXEL_M)
    # It takes voxels itself, and points one by one: of hundreds of thousands that alone would take
    # longer than all the rest.
    thinned = small_gicp.voxelgrid_sampling(sight.points, downsampling_resolution=0.5 * VOXEL_M)
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
        max_correspondence_distance=GICP_DISTANCE_M,
        max_iterations=ICP_ITERATIONS,
    )
    return np.array(refined.T_target_source)


_FPFH = {
    "voxel_m": VOXEL_M,
    "normal_radius_m": NORMAL_RADIUS_M,
    "normal_neighbours": NORMAL_NEIGHBOURS,
    "fpfh_radius_m": FEATURE_RADIUS_M,
    "fpfh_neighbours": FEATURE_NEIGHBOURS,
}
_OF = {"of": "the clouds as they came"}
_ICP = {"point_to_plane_icp": _OF | {"distance_m": ICP_DISTANCE_M, "iterations": ICP_ITERATIONS}}
_RANSAC = {
    "distance_m": RANSAC_DISTANCE_M,
    "points": RANSAC_POINTS,
    "edge_length_ratio": EDGE_LENGTH_RATIO,
    "iterations": RANSAC_ITERATIONS,
    "confidence": RANSAC_CONFIDENCE,
}
_SIFT = {"sift": "OpenCV's defaults", "ratio": MATCH_RATIO, "depth_within_px": DEPTH_WITHIN_PX}
_KISS = {
    "voxel_m": VOXEL_M,
    "kiss_matcher": "defaults for this voxel, from points at half of it",
    "gicp": {"distance_m": GICP_DISTANCE_M, "iterations": ICP_ITERATIONS},
}
_BY_SIFT = _SIFT | {"ransac": _RANSAC} | _ICP
_BY_RANSAC = _FPFH | {"ransac": {"mutual": True, **_RANSAC}} | _ICP
_BY_FGR = _FPFH | {"fgr": {"distance_m": FGR_DISTANCE_M}} | _ICP

PEERS = (
    Peer("sift_ransac_icp", sift_view, sift_ransac_icp, _BY_SIFT, _open3d, True),
    Peer("open3d_ransac_icp", open3d_view, ransac_icp, _BY_RANSAC, _open3d),
    Peer("open3d_fgr_icp", open3d_view, fgr_icp, _BY_FGR, _open3d),
    Peer("kiss_gicp", kiss_view, kiss_gicp, _KISS),
)
