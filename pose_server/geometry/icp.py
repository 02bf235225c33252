"""The Iterative Closest Point algorithm through libraries: generalised (Segal et al. 2009) for
dense clouds and point to point (Besl and McKay 1992) by small_gicp, point to point and point to
plane (Chen and Medioni 1992) by Open3D.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import small_gicp

from fleetpose.pose_server.geometry.errors import MissingLibraryError
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.geometry.se3 import adjoint, inverse, transform
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]

_ITERATIONS = 100  # numerical: of point to point, which needs many


@dataclass(frozen=True)
class IcpSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    normal_neighbours: int = 12  # of a point, which its plane is fitted to


ICP = in_use("icp", IcpSettings())

_SETTLED = 0.03  # numerical: a step of less of the resolution ends the search
_FLATNESS = 2e-3  # derived: m^2, small_gicp's discs of 1e-3 m^2 of both clouds


@dataclass(frozen=True)
class DenseCloud:
    """A down-sampled cloud with covariances and its search tree, ready to be aligned."""

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree
    resolution_m: float


def dense_cloud(points: Floats, resolution_m: float) -> DenseCloud:
    """Prepares points (N, 3) at a resolution in metres."""
    cloud, tree = small_gicp.preprocess_points(
        points, downsampling_resolution=resolution_m, num_threads=1
    )
    return DenseCloud(cloud, tree, resolution_m)


def plain_cloud(points: Floats) -> DenseCloud:
    """Prepares points (N, 3) as they are, for ICP from point to point."""
    cloud = small_gicp.PointCloud(points)
    return DenseCloud(cloud, small_gicp.KdTree(cloud), 0.0)


@dataclass(frozen=True)
class SurfaceFit:
    """A pose that surfaces agree on.

    Attributes:
        T_i_j: (4, 4) camera j in camera i.
        hessian: (6, 6) of left perturbations, rotation first, for points whose distances from the
            other surface have a sigma of one metre.
    """

    T_i_j: Floats
    hessian: Floats


@dataclass(frozen=True)
class Residual:
    """How far points of j are from the nearest of i, of those within a radius: the sum of their
    squared distances, m^2, and how many there are.
    """

    error_m2: float
    count: int

    @property
    def rms_m(self) -> float:
        """Root mean square distance, 0 where no point has a partner."""
        return float(np.sqrt(self.error_m2 / self.count)) if self.count else 0.0


def residual(i: DenseCloud, points_j: Floats, T_i_j: Floats, radius_m: float) -> Residual:
    """What is left between points (M, 3) of j and a cloud of i at a pose."""
    _, distance2 = i.tree.batch_nearest_neighbor_search(transform(T_i_j, points_j))
    near = np.asarray(distance2)
    near = near[near < radius_m**2]
    return Residual(float(near.sum()), len(near))


def gicp(
    i: DenseCloud, j: DenseCloud, T_i_j: Floats, radius_m: float, iterations: int = 20
) -> SurfaceFit:
    """Refines T_i_j with points that are no farther apart than a radius.

    The radius must follow the start's uncertainty: a wide one drags a good start away.
    """
    found = small_gicp.align(
        i.cloud,
        j.cloud,
        i.tree,
        T_i_j,
        max_correspondence_distance=radius_m,
        num_threads=1,
        max_iterations=iterations,
        translation_epsilon=_SETTLED * i.resolution_m,
        rotation_epsilon=1e-3,
    )
    T = np.asarray(found.T_target_source, np.float64)
    back = adjoint(inverse(T))  # small_gicp perturbs from the right
    hessian = back.T @ np.asarray(found.H, np.float64) @ back
    return SurfaceFit(T, _FLATNESS * hessian)


def point_to_point(i: DenseCloud, j: DenseCloud, T_i_j: Floats, radius_m: float) -> Floats:
    """T_i_j by small_gicp's plain ICP, with points no farther apart than a radius."""
    found = small_gicp.align(
        i.cloud,
        j.cloud,
        i.tree,
        T_i_j,
        registration_type="ICP",
        max_correspondence_distance=radius_m,
        num_threads=1,
        max_iterations=_ITERATIONS,
        translation_epsilon=1e-5 * radius_m,
        rotation_epsilon=1e-6,
    )
    return np.asarray(found.T_target_source, np.float64)


def by_open3d(
    points_i: Floats, points_j: Floats, T_i_j: Floats, radius_m: float, method: IcpMethod
) -> Floats:
    """T_i_j by Open3D's ICP, from point to point or to the planes of i.

    Raises:
        MissingLibraryError: Open3D is not there.
    """
    o3d = open3d()
    registration = o3d.pipelines.registration
    i, j = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        for points in (points_i, points_j)
    )
    how = registration.TransformationEstimationPointToPoint()
    if method == "point_to_plane":
        i.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(ICP.normal_neighbours))
        how = registration.TransformationEstimationPointToPlane()
    until = registration.ICPConvergenceCriteria(max_iteration=_ITERATIONS)
    found = registration.registration_icp(j, i, radius_m, T_i_j, how, until)
    return np.array(found.transformation, np.float64)


def has_open3d() -> bool:
    """Whether it can be loaded."""
    try:
        open3d()
    except MissingLibraryError:
        return False
    return True


def open3d():  # noqa: ANN201
    """The library, which needs others of the system.

    Raises:
        MissingLibraryError: it is not there; the text says what to do.
    """
    try:
        import open3d as o3d
    except (ImportError, OSError) as error:
        raise MissingLibraryError(
            f"Open3D cannot be loaded ({error}): pip install 'fleetpose[server]'; it needs "
            "libusb-1.0, libGL and libEGL from the system"
        ) from error
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    return o3d
