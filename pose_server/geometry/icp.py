"""Dense refinement by generalised ICP (Segal et al. 2009) through small_gicp."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import small_gicp

from pose_server.geometry.se3 import adjoint, inverse

Floats = npt.NDArray[np.floating]

_SETTLED = 0.03  # a step of less than this share of the resolution ends the search
_FLATNESS = 2e-3  # m^2: small_gicp takes every point for a disc of 1e-3 m^2 across it, both clouds


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
