"""Clouds survive the wire to the stated quantum, and no bytes do harm."""

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fleetpose.protocol import clouds
from fleetpose.protocol.codec import compress
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import (
    ROBOT_FROM_CAMERA,
    Camera,
    DepthCloud,
    NoiseModel,
    Salient,
    ScatteredCloud,
    View,
    ViewName,
)

sizes = st.tuples(st.integers(1, 50), st.integers(1, 20))
few = settings(max_examples=60, deadline=None)


def view_with(cloud, width, height):
    K = np.array([[60.0, 0.0, width / 2], [0.0, 61.0, height / 2], [0.0, 0.0, 1.0]])
    noise = NoiseModel(pixel_sigma_px=0.7, depth_sigma_m=(0.0, 0.0, 0.001))
    nothing = clouds.SalientPoints(
        np.zeros((0, 2), np.float32),
        np.zeros(0, np.float32),
        np.zeros(0, np.float32),
        np.zeros((0, 128), np.uint8),
    )
    return View(
        name=ViewName(robot="r1", epoch="0" * 12, seq=0),
        stamp_ns=0,
        camera=Camera(
            width=width,
            height=height,
            K=K,
            T_robot_camera=ROBOT_FROM_CAMERA,
            noise=noise,
            kind="rgbd",
        ),
        cloud=cloud,
        salient=clouds.encode_salient(nothing),
    )


@few
@given(sizes.flatmap(lambda size: hnp.arrays(np.uint16, size)))
def test_every_whole_millimetre_comes_back(quanta):
    depth = clouds.decode_depth(clouds.encode_depth(quanta.astype(np.float32) / 1000))
    assert depth.dtype == np.float32
    assert (np.isnan(depth) == (quanta == 0)).all()
    there = quanta > 0
    assert (np.rint(depth[there] * 1000) == quanta[there]).all()


@few
@given(
    sizes.flatmap(lambda size: hnp.arrays(np.float32, size, elements=st.floats(width=32))),
    st.sampled_from([0.0005, 0.001, 0.01]),
)
def test_depth_is_exact_to_half_a_step_and_anything_else_is_no_depth(depth_m, step_m):
    decoded = clouds.decode_depth(clouds.encode_depth(depth_m, step_m))
    surely = np.isfinite(depth_m) & (depth_m > 0.51 * step_m) & (depth_m < 65534 * step_m)
    surely_not = ~(depth_m > 0.49 * step_m) | (depth_m > 65537 * step_m)
    assert np.isfinite(decoded[surely]).all()
    assert np.isnan(decoded[surely_not]).all()
    error = np.abs(decoded[surely].astype(float) - depth_m[surely])
    assert (error <= 0.5 * step_m + 2e-7 * np.abs(depth_m[surely])).all()


@few
@given(sizes.flatmap(lambda size: hnp.arrays(np.uint16, size, elements=st.integers(0, 4000))))
def test_disparity_comes_back_as_depth(sixteenths):
    focal_baseline = 43.75
    cloud = clouds.encode_disparity(sixteenths.astype(np.float32) / 16, focal_baseline)
    depth = clouds.decode_depth(cloud)
    there = sixteenths > 0
    assert np.isnan(depth[~there]).all()
    expected = focal_baseline * 16 / sixteenths[there]
    assert np.allclose(depth[there], expected, rtol=1e-6)


@few
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(0, 40), st.just(3)), elements=st.floats(-2e3, 2e3))
)
def test_scattered_points_come_back_to_half_a_step(columns):
    uv, z = columns[:, :2], columns[:, 2]
    decoded_uv, decoded_z = clouds.decode_scattered(clouds.encode_scattered(uv, z, 0.01))
    quanta = np.rint(np.column_stack((uv * 64, z / 0.01)))
    quanta = quanta[quanta[:, 2] > 0]
    got = np.rint(np.column_stack((decoded_uv * 64, decoded_z / 0.01)))
    assert sorted(map(tuple, got)) == sorted(map(tuple, quanta))
    assert (decoded_z > 0).all()


@few
@given(
    st.integers(0, 30).flatmap(
        lambda n: st.tuples(
            hnp.arrays(np.float32, (n, 2), elements=st.floats(0, 4096, width=32)),
            hnp.arrays(np.float32, (n, 2), elements=st.floats(0.015625, 8, width=32)),
            hnp.arrays(np.uint8, (n, 128)),
            hnp.arrays(np.bool_, n),
        )
    )
)
def test_salient_points_come_back_to_the_bit(parts):
    uv, depth, descriptors, missing = parts
    depth = depth.copy()
    depth[missing] = np.nan
    points = clouds.SalientPoints(uv, depth[:, 0], depth[:, 1], descriptors)
    decoded = clouds.decode_salient(clouds.encode_salient(points))
    assert np.array_equal(decoded.uv, uv)
    assert np.array_equal(decoded.inverse_depth, depth[:, 0], equal_nan=True)
    assert np.array_equal(decoded.inverse_depth_sigma, depth[:, 1], equal_nan=True)
    assert np.array_equal(decoded.descriptors, descriptors)


@pytest.mark.parametrize("fill", [0.0, np.nan, np.inf, -1.0])
def test_a_depth_image_without_any_depth_is_small_and_gives_no_points(fill):
    cloud = clouds.encode_depth(np.full((480, 640), fill, np.float32))
    assert len(cloud.data) < 200
    assert len(clouds.points_of(view_with(cloud, 640, 480)).xyz) == 0


def test_one_pixel_is_a_depth_image():
    assert clouds.decode_depth(clouds.encode_depth(np.array([[1.25]]))).tolist() == [[1.25]]


def test_no_scattered_points_are_a_cloud():
    cloud = clouds.encode_scattered(np.zeros((0, 2)), np.zeros(0), 0.01)
    assert cloud.count == 0
    assert len(clouds.points_of(view_with(cloud, 64, 48)).uv) == 0


def test_scattered_points_that_are_nowhere_are_left_out():
    uv = np.array([[1.0, 2.0], [np.nan, 1.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]])
    z = np.array([1.0, 1.0, np.inf, -2.0, 0.0])
    decoded_uv, decoded_z = clouds.decode_scattered(clouds.encode_scattered(uv, z, 0.01))
    assert decoded_uv.tolist() == [[1.0, 2.0]]
    assert decoded_z.tolist() == [1.0]


def test_a_point_that_the_steps_cannot_express_is_refused():
    with pytest.raises(CodecError, match="steps"):
        clouds.encode_scattered(np.array([[1.0, 1.0]]), np.array([1e9]), 1e-3)


def test_points_of_a_view_lie_on_the_rays_of_their_pixels():
    depth = np.full((48, 64), np.nan, np.float32)
    depth[10, 20] = 2.0
    view = view_with(clouds.encode_depth(depth), 64, 48)
    points = clouds.points_of(view)
    assert points.uv.tolist() == [[20.0, 10.0]]
    assert np.allclose(points.xyz, [[(20 - 32) / 60 * 2, (10 - 24) / 61 * 2, 2.0]])


def test_a_smaller_depth_image_names_pixels_of_the_full_resolution():
    depth = np.full((24, 32), np.nan, np.float32)
    depth[0, 1] = 2.0
    view = view_with(clouds.encode_depth(depth, scale=2), 64, 48)
    assert clouds.points_of(view).uv.tolist() == [[2.5, 0.5]]


def test_a_cloud_of_another_size_than_the_camera_is_refused():
    view = view_with(clouds.encode_depth(np.ones((10, 10))), 64, 48)
    with pytest.raises(CodecError, match="does not fit"):
        clouds.points_of(view)


def examples_of_damage():
    depth = clouds.encode_depth(np.random.default_rng(0).uniform(1, 2, (40, 30)))
    scattered = clouds.encode_scattered(
        np.random.default_rng(1).uniform(0, 600, (50, 2)), np.linspace(1, 2, 50), 0.01
    )
    salient = clouds.encode_salient(
        clouds.SalientPoints(
            np.ones((9, 2), np.float32),
            np.ones(9, np.float32),
            np.ones(9, np.float32),
            np.random.default_rng(2).integers(0, 255, (9, 128), np.uint8),
        )
    )
    return [
        (clouds.decode_depth, depth),
        (clouds.decode_scattered, scattered),
        (clouds.decode_salient, salient),
    ]


@pytest.mark.parametrize(("decode", "good"), examples_of_damage())
def test_damaged_bytes_give_a_codec_error_or_another_valid_cloud(decode, good):
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(300):
        data = bytearray(good.data)
        for place in rng.integers(0, len(data), 3):
            data[place] ^= 1 << int(rng.integers(8))
        damaged = good.model_copy(update={"data": bytes(data)})
        try:
            decode(damaged)
        except CodecError:
            refused += 1
    assert refused > 0
    for cut in (0, 1, 5, len(good.data) // 2, len(good.data) - 1):
        with pytest.raises(CodecError):
            decode(good.model_copy(update={"data": good.data[:cut]}))


@pytest.mark.parametrize(("decode", "good"), examples_of_damage())
def test_bytes_that_are_no_zstd_are_refused(decode, good):
    with pytest.raises(CodecError):
        decode(good.model_copy(update={"data": b"\x00" * 100}))


def test_a_block_of_another_size_than_stated_is_refused_unread():
    bomb = compress(bytes(50_000_000))
    assert len(bomb) < 10_000
    with pytest.raises(CodecError, match="does not hold"):
        clouds.decode_depth(
            DepthCloud(width=640, height=480, coding="depth", step=0.001, data=bomb)
        )
    with pytest.raises(CodecError, match="does not hold"):
        clouds.decode_scattered(
            ScatteredCloud(count=10, pixel_step_px=0.1, depth_step_m=0.1, data=bomb)
        )
    with pytest.raises(CodecError, match="does not hold"):
        clouds.decode_salient(Salient(extractor="x", count=10, descriptor_bytes=128, data=bomb))


def test_a_block_without_a_stated_size_is_refused_unread():
    endless = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(2 * 640 * 480))
    with pytest.raises(CodecError, match="does not hold"):
        clouds.decode_depth(
            DepthCloud(width=640, height=480, coding="depth", step=0.001, data=endless)
        )


def test_an_honest_but_huge_cloud_is_refused():
    with pytest.raises(CodecError, match="are refused"):
        clouds.decode_depth(
            DepthCloud(width=16384, height=16384, coding="depth", step=0.001, data=b"")
        )


@pytest.mark.parametrize("step", [1e-320, 1e-35, 1e35, 1e300])
def test_absurd_steps_are_refused(step):
    good = clouds.encode_depth(np.ones((4, 4)))
    with pytest.raises(CodecError, match="step"):
        clouds.decode_depth(good.model_copy(update={"step": step}))
    disparity = clouds.encode_disparity(np.ones((4, 4)), 50.0)
    with pytest.raises(CodecError, match="step"):
        clouds.decode_depth(disparity.model_copy(update={"focal_baseline_px_m": step}))
    scattered = clouds.encode_scattered(np.ones((3, 2)), np.ones(3), 0.1)
    with pytest.raises(CodecError, match="no place"):
        clouds.decode_scattered(scattered.model_copy(update={"depth_step_m": step}))


def test_kinect_like_depth_takes_few_bits():
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[0:480, 0:640]
    depth = 1.5 + rows / 900 + 0.4 * (columns > 300) + rng.normal(0, 0.001, rows.shape)
    depth[200:230, 100:180] = np.nan
    cloud = clouds.encode_depth(depth.astype(np.float32))
    assert 8 * len(cloud.data) / np.isfinite(depth).sum() < 3.6
