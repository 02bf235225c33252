"""Clicks become points: near a click as from the whole cloud, and never where there is no depth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.correspondences.lifting import Lifter, NoDepthError
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.lift import lift_pixel
from fleetpose.pose_server.registration.prepared_view import point_noise
from fleetpose.pose_server.state.views import MIN_POINTS, KeptView, open_view
from fleetpose.protocol.clouds import encode_depth, points_of
from fleetpose.protocol.codec import pack
from fleetpose.protocol.messages import View
from tests.pose_server.scene import SIZE, descriptors, view, walls


def dense_view(depth: np.ndarray, scale: int = 1) -> View:
    rng = np.random.default_rng(0)
    scattered = view(rng, "r1", walls(rng, 60), descriptors(rng, 60), np.eye(4))
    return scattered.model_copy(update={"cloud": encode_depth(depth, 1e-3, scale)})


def slanted(scale: int, holes: float, seed: int) -> np.ndarray:
    """A slanted wall with a step in it, and holes."""
    height, width = SIZE[1] // scale, SIZE[0] // scale
    rows, columns = np.mgrid[:height, :width]
    depth = 5.0 + 0.002 * scale * columns + 2.0 * (rows * scale > 200)
    depth[np.random.default_rng(seed).random((height, width)) < holes] = np.nan
    return depth


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from((1, 2, 4)),
    st.sampled_from((0.0, 0.5, 0.98, 0.999)),
    st.integers(0, 5),
    st.tuples(st.floats(0, SIZE[0] - 1), st.floats(0, SIZE[1] - 1)),
)
def test_what_is_near_gives_the_point_that_the_whole_cloud_gives(scale, holes, seed, pixel):
    message = dense_view(slanted(scale, holes, seed), scale)
    assume(len(points_of(message).xyz) >= MIN_POINTS)  # the server refuses others
    kept, points, at = open_view(pack(message), None, 0.0), points_of(message), np.array(pixel)
    noise = point_noise(message.camera.noise)
    try:
        whole = lift_pixel(at, points.uv, points.xyz[:, 2], message.camera.K, noise, 2.0 * scale)
    except DegenerateGeometryError as error:
        with pytest.raises(NoDepthError, match=str(error)):
            Lifter().lift(kept, at)
        return
    near = Lifter().lift(kept, at)
    # of neighbours that are equally far either may be taken
    assert np.linalg.norm(near.p - whole.p) < 0.02 * whole.sigma_z
    assert near.sigma_z == pytest.approx(whole.sigma_z, rel=1e-3)


def test_a_hole_says_how_far_depth_is_and_outside_is_outside():
    depth = np.full((SIZE[1], SIZE[0]), 5.0)
    depth[100:140, 100:140] = np.nan
    kept = open_view(pack(dense_view(depth)), None, 0.0)
    with pytest.raises(NoDepthError, match="nearest usable point is 20 px away"):
        Lifter().lift(kept, np.array((119.0, 119.0)))
    for outside in ((-0.6, 5.0), (5.0, SIZE[1] - 0.4), (1e9, 0.0)):
        with pytest.raises(NoDepthError, match="outside the image"):
            Lifter().lift(kept, np.array(outside))


def test_a_second_click_does_not_decode_again_and_old_clouds_go(monkeypatch):
    kept = open_view(pack(dense_view(slanted(1, 0.0, 0))), None, 0.0)
    lifter = Lifter()
    first = lifter.lift(kept, np.array((50.0, 50.0)))
    decoded: list[KeptView] = []
    of = Lifter._decoded
    monkeypatch.setattr(
        Lifter, "_decoded", staticmethod(lambda one: decoded.append(one) or of(one))
    )
    again = lifter.lift(kept, np.array((50.0, 50.0)))
    assert not decoded and np.array_equal(first.p, again.p)
    for seq in range(1, 9):
        name = kept.name.model_copy(update={"seq": seq})
        lifter.lift(replace(kept, name=name), np.array((50.0, 50.0)))
    lifter.lift(kept, np.array((50.0, 50.0)))
    assert len(decoded) == 9
