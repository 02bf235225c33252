"""Dense refinement by generalised ICP (Segal et al. 2009) through small_gicp."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import small_gicp

Floats = npt.NDArray[np.floating]


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


def gicp(i: DenseCloud, j: DenseCloud, T_i_j: Floats, radii_m: tuple[float, ...]) -> Floats:
    """Refines T_i_j with shrinking correspondence radii.

    The radius must follow the start's uncertainty: a wide one drags a good start away.
    """
    T = T_i_j
    for radius in radii_m:
        result = small_gicp.align(
            i.cloud,
            j.cloud,
            i.tree,
            T,
            max_correspondence_distance=radius,
            num_threads=1,
            max_iterations=20,
            translation_epsilon=1e-4 * i.resolution_m,
            rotation_epsilon=1e-5,
        )
        T = np.asarray(result.T_target_source, np.float64)
    return T
