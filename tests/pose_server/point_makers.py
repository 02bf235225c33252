"""Corresponding points for tests: made by known motions, with the noise of stereo cameras."""

import numpy as np
from hypothesis import strategies as st

from fleetpose.pose_server.geometry.noise import covariances
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose, transform

FOCAL_PX, PIXEL_SIGMA_PX, DEPTH_SHARE = 600.0, 1.5, 0.01

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
"""Random generators."""


def random_pose(rng: np.random.Generator, size: float = 5.0) -> np.ndarray:
    return make_pose(exp_so3(rng.normal(0, 1, 3)), rng.normal(0, size, 3))


def round_the_scene(rng: np.random.Generator) -> np.ndarray:
    """T_a_b of a camera that walked 40 to 90 degrees round a scene 10 m ahead."""
    w = np.array([0.0, rng.choice([-1, 1]) * np.radians(rng.uniform(40, 90)), 0.0])
    centre = np.array([0.0, 0.0, 10.0])
    R = exp_so3(w + rng.normal(0, 0.1, 3))
    return make_pose(R, centre - R @ centre)


def seen_by_two(rng: np.random.Generator, T_a_b: np.ndarray, count: int) -> PointPairs:
    """Points far apart around the middle of the scene, as two noisy stereo cameras lift them."""
    points = np.array([0.0, 0.0, 10.0]) + _far_apart(rng, count)
    sides = []
    for p in (points, transform(inverse(T_a_b), points)):
        sigma = DEPTH_SHARE * p[:, 2]
        C = covariances(p, FOCAL_PX, PIXEL_SIGMA_PX, sigma)
        sides.append(
            (np.array([rng.multivariate_normal(m, c) for m, c in zip(p, C, strict=True)]), C)
        )
    return PointPairs(sides[0][0], sides[1][0], sides[0][1], sides[1][1])


def _far_apart(rng: np.random.Generator, count: int) -> np.ndarray:
    """Of many points in a box the ones that an operator would pick."""
    many = rng.uniform(-2.5, 2.5, (60, 3))
    chosen = [0]
    while len(chosen) < count:
        gaps = np.linalg.norm(many[:, None] - many[chosen], axis=2).min(axis=1)
        chosen.append(int(gaps.argmax()))
    return many[chosen]
