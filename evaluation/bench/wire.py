"""`pose-eval wire`: our cloud codecs beside PNG, Draco and raw numbers, and the size of a view."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.data.anonymize import noise_model
from fleetpose.evaluation.data.opening import points_of
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.data.rgbd import DEPTH_UNIT_M, read_depth
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.options.recorded import WireOptions
from fleetpose.evaluation.report import output
from fleetpose.protocol import clouds, codec
from fleetpose.protocol.messages import (
    ROBOT_FROM_CAMERA,
    Camera,
    DepthCloud,
    NoiseModel,
    ScatteredCloud,
    ViewName,
)
from fleetpose.robot_agent.cameras.base import DepthImage, Frame, ScatteredPoints
from fleetpose.robot_agent.cameras.rgbd.recording import KINECT_NOISE
from fleetpose.robot_agent.features.keypoints import salient_points
from fleetpose.robot_agent.features.packing import cloud_of, view_of

COLUMNS = ("codec", "bits_per_point", "error_max_m", "encode_ms", "decode_ms")
REPETITIONS = 7
SALIENT_POINTS = 1000
DRACO_BITS = 12
PNG_LEVEL = 3
_EPOCH = "0" * 12


@dataclass(frozen=True)
class Seen:
    """One view: its points (N, 3) in metres, and the frame an agent would send."""

    xyz: Floats
    frame: Frame


@dataclass(frozen=True)
class Codec:
    """A way to bytes and back.

    Attributes:
        encode: a view to what `decode` takes.
        size: of that in bytes.
        decode: to points (N, 3) in metres, or for images a depth image (H, W).
        prepare: what a view is to `encode`; not counted, as the camera has it so.
    """

    prepare: Callable[[Seen], Any]
    encode: Callable[[Any], Any]
    size: Callable[[Any], int]
    decode: Callable[[Any], npt.NDArray[np.floating]]


@dataclass(frozen=True)
class Row:
    """What one codec does with one view."""

    bits_per_point: float
    error_max_m: float
    encode_ms: float
    decode_ms: float


def run(options: WireOptions, out: Path) -> dict[str, Any]:
    """Measures on views spread evenly over a recording; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used.
    """
    import cv2

    cv2.setNumThreads(1)
    recording = options.recording()
    output.output_folder(out)
    usable = recording.usable
    chosen = np.unique(np.linspace(0, len(usable) - 1, min(options.views, len(usable))).astype(int))
    codecs = codecs_of(recording)
    rows: dict[str, list[Row]] = {name: [] for name in codecs}
    sizes: dict[int, list[tuple[int, int]]] = {SALIENT_POINTS: [], default_salient(): []}
    with output.progress_bar() as progress:
        for index in progress.track(chosen, description="views"):
            seen = seen_of(recording, usable[index])
            for name, one in codecs.items():
                rows[name].append(measured(one, seen))
            for count, found in sizes.items():
                found.append(view_size(seen, count))
    table = [{"codec": name, **_mean(found)} for name, found in rows.items()]
    output.write_csv(out / "wire.csv", COLUMNS, table)
    summary = {
        "views": len(chosen),
        "points_mean": float(np.mean([len(seen_of(recording, usable[i]).xyz) for i in chosen])),
        "codecs": {row["codec"]: {k: row[k] for k in COLUMNS[1:]} for row in table},
        "lossless": all(is_lossless(seen_of(recording, usable[index])) for index in chosen),
        **_view_summary("", SALIENT_POINTS, sizes[SALIENT_POINTS]),
        **_view_summary("_default", default_salient(), sizes[default_salient()]),
        "not_measured": [] if "draco" in codecs else ["draco: DracoPy is not installed"],
    }
    output.write_summary(out, summary)
    output.print_table("wire", COLUMNS, ([row[k] for k in COLUMNS] for row in table))
    flat = ((k, v) for k, v in summary.items() if k != "codecs")
    output.print_table("views", ("what", "value"), flat)
    return summary


def default_salient() -> int:
    """So many salient points does an agent send, if not told."""
    from fleetpose.robot_agent.sender import SenderSettings

    return SenderSettings().max_salient


def seen_of(recording: Recording, view: TrueView) -> Seen:
    """A view of a recording as its camera would give it."""
    import cv2

    image = cv2.imread(str(view.image), cv2.IMREAD_COLOR)
    uv, xyz = points_of(view)
    stated = None if recording.clouds is None else noise_model(recording.clouds, view)
    camera = Camera(
        width=view.width,
        height=view.height,
        K=view.K,
        T_robot_camera=ROBOT_FROM_CAMERA,
        noise=KINECT_NOISE if stated is None else NoiseModel.model_validate(stated),
        kind="rgbd" if stated is None else "views",
    )
    if stated is None:
        assert view.cloud is not None
        ranges = DepthImage(read_depth(view.cloud).astype(np.float32))
    else:
        uv = (xyz @ view.K.T)[:, :2] / xyz[:, 2:]
        ranges = ScatteredPoints(uv, xyz[:, 2])
    return Seen(xyz, Frame(0, np.asarray(image, np.uint8), ranges, camera))


def codecs_of(recording: Recording) -> dict[str, Codec]:
    """The codecs that can take a recording's clouds."""
    found = {"raw_float32_xyz": _raw_xyz()}
    if recording.is_rgbd:
        found |= {"raw_uint16_mm": _raw_mm(), f"png16_level{PNG_LEVEL}": _png()}
    if find_spec("DracoPy") is not None:
        found["draco"] = _draco()
    return found | {"fleetpose": _ours()}


def measured(one: Codec, seen: Seen) -> Row:
    """A codec on a view: medians of several repetitions, on one thread."""
    ready = one.prepare(seen)
    encoded, encode_ms = _timed(lambda: one.encode(ready))
    decoded, decode_ms = _timed(lambda: one.decode(encoded))
    bits = 8 * one.size(encoded) / len(seen.xyz)
    return Row(bits, _error_m(decoded, seen), encode_ms, decode_ms)


def is_lossless(seen: Seen) -> bool:
    """Whether ours gives back every millimetre of a depth image, or every scattered point to half a
    step of pixel and depth.
    """
    cloud = cloud_of(seen.frame.ranges, seen.frame.model)
    if isinstance(cloud, DepthCloud):
        assert isinstance(seen.frame.ranges, DepthImage)
        given = np.nan_to_num(seen.frame.ranges.depth_m, nan=0.0)
        got = np.nan_to_num(clouds.decode_depth(cloud), nan=0.0)
        return bool((np.rint(given / DEPTH_UNIT_M) == np.rint(got / DEPTH_UNIT_M)).all())
    assert isinstance(seen.frame.ranges, ScatteredPoints)
    given, got = _sorted(seen.frame.ranges.uv, seen.frame.ranges.z, cloud), _decoded_sorted(cloud)
    steps = (cloud.pixel_step_px, cloud.pixel_step_px, cloud.depth_step_m)
    return given.shape == got.shape and bool((np.abs(given - got) <= 0.501 * np.array(steps)).all())


def view_size(seen: Seen, salient: int) -> tuple[int, int]:
    """Bytes on the wire of the whole view with at most so many salient points, and how many it
    has.
    """
    frame = seen.frame
    points = salient_points(frame.image, frame.ranges, frame.model, salient)
    name = ViewName(robot="r1", epoch=_EPOCH, seq=0)
    return len(codec.pack(view_of(name, frame, points))), len(points.uv)


def _view_summary(ending: str, asked: int, sizes: Sequence[tuple[int, int]]) -> dict[str, float]:
    found = np.array(sizes)
    return {
        f"view_bytes{ending}": float(found[:, 0].mean()),
        f"view_bytes{ending}_max": int(found[:, 0].max()),
        f"view_salient{ending}": asked,
        f"view_salient{ending}_found": float(found[:, 1].mean()),
    }


def _mean(rows: Sequence[Row]) -> dict[str, float]:
    means = {name: float(np.mean([getattr(row, name) for row in rows])) for name in COLUMNS[1:]}
    return means | {"error_max_m": float(np.max([row.error_max_m for row in rows]))}


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    result, times = None, []
    for _ in range(REPETITIONS):
        began = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - began)
    return result, 1e3 * float(np.median(times))


def _error_m(decoded: npt.NDArray[np.floating], seen: Seen) -> float:
    """The largest distance of a point to what it became."""
    ranges = seen.frame.ranges
    if isinstance(ranges, DepthImage) and decoded.shape == ranges.depth_m.shape:
        lost = np.isnan(decoded) != np.isnan(ranges.depth_m)
        if lost.any():
            return float("inf")
        stretch = np.linalg.norm(seen.xyz, axis=1) / seen.xyz[:, 2]
        there = ~np.isnan(decoded)
        depth_error = np.abs(decoded[there].astype(np.float64) - ranges.depth_m[there])
        return float((depth_error * stretch).max())
    from scipy.spatial import cKDTree

    if len(decoded) == len(seen.xyz):
        apart = np.linalg.norm(decoded - seen.xyz, axis=1)
        if apart.max() < 1e-3:  # in the order given
            return float(apart.max())
    return float(cKDTree(decoded).query(seen.xyz, workers=1)[0].max())


def _raw_xyz() -> Codec:
    return Codec(
        lambda seen: seen.xyz.astype(np.float32),
        lambda xyz: xyz.tobytes(),
        len,
        lambda raw: np.frombuffer(raw, np.float32).reshape(-1, 3),
    )


def _millimetres(seen: Seen) -> npt.NDArray[np.uint16]:
    assert isinstance(seen.frame.ranges, DepthImage)
    depth = np.nan_to_num(seen.frame.ranges.depth_m, nan=0.0)
    return np.rint(depth / DEPTH_UNIT_M).astype(np.uint16)


def _metres(mm: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    return np.where(mm == 0, np.float32(np.nan), mm * np.float32(DEPTH_UNIT_M))


def _raw_mm() -> Codec:
    def decode(encoded: tuple[bytes, tuple[int, int]]) -> npt.NDArray[np.float32]:
        raw, shape = encoded
        return _metres(np.frombuffer(raw, np.uint16).reshape(shape))

    return Codec(
        _millimetres, lambda mm: (mm.tobytes(), mm.shape), lambda encoded: len(encoded[0]), decode
    )


def _png() -> Codec:
    import cv2

    return Codec(
        _millimetres,
        lambda mm: cv2.imencode(".png", mm, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])[1],
        len,
        lambda png: _metres(np.asarray(cv2.imdecode(png, cv2.IMREAD_UNCHANGED), np.uint16)),
    )


def _draco() -> Codec:
    import DracoPy  # pyright: ignore[reportMissingImports]

    return Codec(
        lambda seen: seen.xyz.astype(np.float32),
        lambda xyz: DracoPy.encode(xyz, quantization_bits=DRACO_BITS),
        len,
        lambda encoded: np.asarray(DracoPy.decode(encoded).points),
    )


def _ours() -> Codec:
    camera: list[Camera] = []  # of the view that was prepared last

    def prepare(seen: Seen) -> Frame:
        camera[:] = [seen.frame.model]
        return seen.frame

    def decode(cloud: DepthCloud | ScatteredCloud) -> npt.NDArray[np.floating]:
        if isinstance(cloud, DepthCloud):
            return clouds.decode_depth(cloud)
        return clouds.lift(*clouds.decode_scattered(cloud), camera[0].K)

    return Codec(
        prepare,
        lambda frame: cloud_of(frame.ranges, frame.model),
        lambda cloud: len(codec.pack(cloud)),
        decode,
    )


def _sorted(uv: Floats, z: Floats, cloud: ScatteredCloud) -> Floats:
    """Points in the order in which the codec keeps them."""
    steps = np.array((cloud.pixel_step_px, cloud.pixel_step_px, cloud.depth_step_m))
    columns = np.column_stack((uv, z))
    quanta = np.rint(columns / steps)
    return columns[np.lexsort((quanta[:, 2], quanta[:, 0], quanta[:, 1]))]


def _decoded_sorted(cloud: ScatteredCloud) -> Floats:
    return _sorted(*clouds.decode_scattered(cloud), cloud)
