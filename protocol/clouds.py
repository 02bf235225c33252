"""Clouds and salient points to compact bytes and back, exact to a stated quantum.

Organised clouds: difference to the row above, zigzag, byte shuffle, zstd. On Kinect depth this
takes 2.5 bit per point and a quarter of 16-bit PNG's time. Scattered clouds: the same on sorted
columns of u, v and z.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.codec import compress, decompress
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import Camera, DepthCloud, Salient, ScatteredCloud, View

Floats = npt.NDArray[np.float64]
MAX_CLOUD_PIXELS = 4_200_000  # more make a server work for seconds, and compress to almost nothing
NEAREST_M, FURTHEST_M = 1e-4, 1e5  # what is beyond is no measurement, and squares badly
CLICK_REACH_CELLS, CLICK_REACH_PX = 2.0, 6.0
"""How far from a point with depth a click may be: cells of a depth image, pixels among scattered
points.
"""


@dataclass(frozen=True)
class SalientPoints:
    """Salient points of one view.

    Attributes:
        uv: (N, 2) float32 pixels of the rectified image.
        inverse_depth: (N,) float32, 1/m; nan where the point has no depth.
        inverse_depth_sigma: (N,) float32, 1/m; nan where the point has no depth.
        descriptors: (N, D) uint8.
    """

    uv: npt.NDArray[np.float32]
    inverse_depth: npt.NDArray[np.float32]
    inverse_depth_sigma: npt.NDArray[np.float32]
    descriptors: npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Points:
    """A decoded cloud: (N, 2) full-resolution pixels, (N, 3) points in the camera frame, metres."""

    uv: Floats
    xyz: Floats


def encode_depth(
    depth_m: npt.NDArray[np.floating], step_m: float = 0.001, scale: int = 1
) -> DepthCloud:
    """Encodes a depth image (H, W) in metres, exact to half a step.

    0, negative, nan and inf mean no depth; so does what rounds to 0 or lies beyond 65535 steps.
    """
    return DepthCloud(
        width=depth_m.shape[1],
        height=depth_m.shape[0],
        scale=scale,
        coding="depth",
        step=step_m,
        data=_pack_grid(_quantised(depth_m, step_m)),
    )


def encode_disparity(
    disparity_px: npt.NDArray[np.floating],
    focal_baseline_px_m: float,
    step_px: float = 1 / 16,
    scale: int = 1,
) -> DepthCloud:
    """Encodes a disparity image (H, W), full-resolution px; what is not above 0 is no depth."""
    return DepthCloud(
        width=disparity_px.shape[1],
        height=disparity_px.shape[0],
        scale=scale,
        coding="disparity",
        step=step_px,
        focal_baseline_px_m=focal_baseline_px_m,
        data=_pack_grid(_quantised(disparity_px, step_px)),
    )


def decode_depth(cloud: DepthCloud) -> npt.NDArray[np.float32]:
    """Depth image (H, W) float32 in metres, nan where there is none.

    Raises:
        CodecError: the data does not hold an image of that size, or its steps are absurd.
    """
    return _decoded(cloud, 1)


def _decoded(cloud: DepthCloud, every: int) -> npt.NDArray[np.float32]:
    """Every so many rows and columns of the depth image."""
    if cloud.width * cloud.height > MAX_CLOUD_PIXELS:
        raise CodecError(f"{cloud.width}x{cloud.height} pixels of depth are refused: scale them")
    _check_range(cloud)
    quanta = _unpack_grid(cloud.data, cloud.height, cloud.width, every)
    depth = quanta.astype(np.float32)
    depth *= np.float32(cloud.step)
    np.copyto(depth, np.float32(np.nan), where=quanta == 0)
    if cloud.focal_baseline_px_m is not None:
        np.divide(np.float32(cloud.focal_baseline_px_m), depth, out=depth)
    return depth


def encode_scattered(
    uv: Floats, z: Floats, depth_step_m: float, pixel_step_px: float = 1 / 64
) -> ScatteredCloud:
    """Encodes points by pixel (N, 2) and depth (N,) along the optical axis, in metres.

    The order is not kept, and points without a finite place in front of the camera are left out.
    """
    columns = np.rint(np.column_stack((uv / pixel_step_px, z / depth_step_m)))
    columns = columns[np.isfinite(columns).all(1) & (columns[:, 2] > 0)]
    if columns.size and np.abs(columns).max() >= 2**30:
        raise CodecError("a point lies beyond what the steps can express")
    quanta = columns.astype(np.int32)
    quanta = quanta[np.lexsort((quanta[:, 0], quanta[:, 1]))]
    delta = np.diff(quanta, axis=0, prepend=np.int32(0)).T
    return ScatteredCloud(
        count=len(quanta),
        pixel_step_px=pixel_step_px,
        depth_step_m=depth_step_m,
        data=compress(_shuffle(_zigzag(np.ascontiguousarray(delta)))),
    )


def decode_scattered(cloud: ScatteredCloud) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and depths (N,) in metres.

    Raises:
        CodecError: the data does not hold that many points, or one is not in front of the camera.
    """
    raw = decompress(cloud.data, 12 * cloud.count)
    delta = _unzigzag(_unshuffle(raw, np.dtype(np.uint32)).reshape(3, cloud.count))
    quanta = np.cumsum(delta, axis=1, dtype=np.int32)
    uv = np.asarray(quanta[:2].T * cloud.pixel_step_px, np.float64)
    z = np.asarray(quanta[2] * cloud.depth_step_m, np.float64)
    if not (np.isfinite(uv).all() and ((z > 1e-30) & (z < 1e30)).all()):
        raise CodecError("a point of the cloud has no place in front of the camera")
    return uv, z


def encode_salient(points: SalientPoints, extractor: str = "rootsift") -> Salient:
    """Encodes salient points; descriptors dominate the size and are kept to the bit."""
    floats = np.column_stack((points.uv, points.inverse_depth, points.inverse_depth_sigma))
    data = np.ascontiguousarray(floats, np.float32).tobytes() + points.descriptors.tobytes()
    return Salient(
        extractor=extractor,
        count=len(points.uv),
        descriptor_bytes=max(points.descriptors.shape[1], 1),
        data=compress(data),
    )


def decode_salient(salient: Salient) -> SalientPoints:
    """Decodes salient points.

    Raises:
        CodecError: the data does not hold that many points, or pixels are not finite.
    """
    n, d = salient.count, salient.descriptor_bytes
    raw = decompress(salient.data, n * (16 + d))
    floats = np.frombuffer(raw, np.float32, 4 * n).reshape(n, 4)
    if not np.isfinite(floats[:, :2]).all():
        raise CodecError("a salient point has no finite pixel")
    depth = floats[:, 2:].copy()
    inverse, sigma = depth.T
    there = (inverse >= 1 / FURTHEST_M) & (inverse <= 1 / NEAREST_M) & (sigma > 0) & (sigma < 1e6)
    depth[~there] = np.nan
    descriptors = np.frombuffer(raw, np.uint8, n * d, 16 * n).reshape(n, d)
    return SalientPoints(floats[:, :2], depth[:, 0], depth[:, 1], descriptors)


def strongest(points: SalientPoints, count: int) -> SalientPoints:
    """The first so many of salient points, which come strongest first."""
    return SalientPoints(
        points.uv[:count],
        points.inverse_depth[:count],
        points.inverse_depth_sigma[:count],
        points.descriptors[:count],
    )


def points_of(view: View, at_most: int | None = None) -> Points:
    """The points of a view in its camera frame, or so many of them, drawn evenly but the same every
    time.

    Raises:
        CodecError: the cloud is damaged, does not fit the camera, or has impossible depths.
    """
    cloud = view.cloud
    if isinstance(cloud, ScatteredCloud):
        uv, z = decode_scattered(cloud)
    else:
        depth = depth_image(cloud, view.camera)
        there = _thinned(np.flatnonzero(np.isfinite(depth)), at_most)
        rows, columns = np.divmod(there, cloud.width)
        uv = grid_to_pixel(np.column_stack((columns, rows)), cloud.scale)
        z = depth.reshape(-1)[there].astype(np.float64)
        return _lifted(uv, z, view.camera)
    kept = _thinned(np.arange(len(z)), at_most)
    return _lifted(uv[kept], z[kept], view.camera)


def some_points_of(view: View, about: int) -> Points:
    """About so many of a view's points, at even steps over its image or its list: a glance that
    costs a fraction of `points_of`, but finds a damaged cloud as well.

    Raises:
        CodecError: like `points_of`.
    """
    cloud = view.cloud
    if isinstance(cloud, ScatteredCloud):
        uv, z = decode_scattered(cloud)
        every = slice(None, None, max(len(z) // about, 1))
        return _lifted(uv[every], z[every], view.camera)
    _check_size(cloud, view.camera)
    every = max(int((cloud.width * cloud.height / about) ** 0.5), 1)
    depth = _decoded(cloud, every)
    rows, columns = np.nonzero(np.isfinite(depth))
    uv = grid_to_pixel(np.column_stack((columns, rows)) * every, cloud.scale)
    return _lifted(uv, depth[rows, columns].astype(np.float64), view.camera)


def _lifted(uv: Floats, z: Floats, camera: Camera) -> Points:
    if len(z) and not (z.min() >= NEAREST_M and z.max() <= FURTHEST_M):
        raise CodecError(f"depths from {z.min():g} to {z.max():g} m are no measurements")
    return Points(uv, lift(uv, z, camera.K))


def _thinned(index: npt.NDArray[np.intp], at_most: int | None) -> npt.NDArray[np.intp]:
    if at_most is None or len(index) <= at_most:
        return index
    return np.sort(np.random.default_rng(0).choice(index, at_most, replace=False))


def depth_image(cloud: DepthCloud, camera: Camera) -> npt.NDArray[np.float32]:
    """Decodes an organised cloud and checks it against the camera's size."""
    _check_size(cloud, camera)
    return decode_depth(cloud)


def _check_size(cloud: DepthCloud, camera: Camera) -> None:
    if (cloud.width * cloud.scale, cloud.height * cloud.scale) != (camera.width, camera.height):
        raise CodecError(
            f"cloud {cloud.width}x{cloud.height} x {cloud.scale} does not fit camera "
            f"{camera.width}x{camera.height}"
        )


def grid_to_pixel(grid: npt.NDArray[np.generic], scale: int) -> Floats:
    """Full-resolution pixels of the centres of grid cells that are `scale` pixels wide."""
    pixels = grid.astype(np.float64)
    if scale != 1:
        pixels += 0.5
        pixels *= scale
        pixels -= 0.5
    return pixels


def lift(uv: Floats, z: Floats, K: Floats) -> Floats:
    """Points (N, 3) in the camera frame from pixels (N, 2) and depths (N,) along the axis."""
    K_inv = np.linalg.inv(K)
    u, v = uv.T
    xyz = np.empty((len(uv), 3))
    # written out: a product of (N, 3) by (3, 3) takes BLAS many times as long
    xyz[:, 0] = (K_inv[0, 0] * u + K_inv[0, 1] * v + K_inv[0, 2]) * z
    xyz[:, 1] = (K_inv[1, 1] * v + K_inv[1, 2]) * z
    xyz[:, 2] = z
    return xyz


def _quantised(image: npt.NDArray[np.floating], step: float) -> npt.NDArray[np.uint16]:
    """Whole steps, 0 where there is no measurement; in few passes, as it runs per frame."""
    with np.errstate(over="ignore"):  # what leaves the range of float32 leaves that of the steps
        steps = np.multiply(image, 1 / step, dtype=np.result_type(image, np.float32))
    np.rint(steps, out=steps)
    steps[~((steps > 0) & (steps < 65536))] = 0  # nan compares false
    return steps.astype(np.uint16)


def _check_range(cloud: DepthCloud) -> None:
    """Refuses steps whose depths leave the range of float32."""
    largest, smallest = 65535 * cloud.step, cloud.step
    if cloud.focal_baseline_px_m is not None:
        largest, smallest = (
            cloud.focal_baseline_px_m / smallest,
            cloud.focal_baseline_px_m / largest,
        )
    if not (1e-30 < cloud.step < 1e30 and smallest > 1e-30 and largest < 1e30):
        raise CodecError(f"a cloud with a step of {cloud.step} cannot be depths in metres")


def _pack_grid(quanta: npt.NDArray[np.uint16]) -> bytes:
    words = quanta.view(np.int16)
    delta = np.empty_like(words)
    delta[:1] = words[:1]
    np.subtract(words[1:], words[:-1], out=delta[1:])  # wraps modulo 2^16, and so does the way back
    return compress(_shuffle(_zigzag(delta)))


def _unpack_grid(data: bytes, height: int, width: int, every: int) -> npt.NDArray[np.uint16]:
    """Every so many rows and columns: a column needs no other one, but all of its rows."""
    raw = decompress(data, 2 * height * width)
    planes = np.frombuffer(raw, np.uint8).reshape(2, height, width)[:, :, ::every]
    grid = _unzigzag(_joined(planes, np.dtype(np.uint16)))
    _add_up_rows(grid)
    return grid[::every].view(np.uint16)


def _add_up_rows(grid: npt.NDArray[np.int16], band: int = 16) -> None:
    """`np.cumsum` over the rows, in place; in bands of rows, which is three times as fast."""
    height, width = grid.shape
    bands = grid[: height - height % band].reshape(-1, band, width)
    for k in range(1, band):
        bands[:, k] += bands[:, k - 1]
    for above, below in itertools.pairwise(bands):
        below += above[-1]
    for row in range(max(len(bands) * band, 1), height):
        grid[row] += grid[row - 1]


def _zigzag(delta: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Small negative and positive numbers both become small unsigned ones; takes the array over."""
    sign = delta >> (8 * delta.itemsize - 1)
    delta <<= 1
    delta ^= sign
    return delta.view(delta.dtype.str.replace("i", "u"))


def _unzigzag(words: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Undoes `_zigzag`; takes the array over."""
    signed = words.dtype.str.replace("u", "i")
    sign = -(words & 1).view(signed)
    words >>= 1
    delta = words.view(signed)
    delta ^= sign
    return delta


def _shuffle(words: npt.NDArray[Any]) -> bytes:
    """All low bytes first, then the next: the high ones are mostly zero and cost nothing."""
    flat = words.reshape(-1)
    planes = np.empty((flat.itemsize, flat.size), np.uint8)
    for k, plane in enumerate(planes):
        np.copyto(plane, flat >> 8 * k if k else flat, casting="unsafe")
    return planes.tobytes()


def _unshuffle(raw: bytes, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    return _joined(np.frombuffer(raw, np.uint8).reshape(dtype.itemsize, -1), dtype)


def _joined(planes: npt.NDArray[np.uint8], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Words from their bytes, the low ones first."""
    words = planes[-1].astype(dtype)
    for plane in planes[-2::-1]:
        words <<= 8
        words |= plane
    return words
