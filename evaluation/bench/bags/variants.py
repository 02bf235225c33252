"""One scene in the forms in which bags come, and how exactly each keeps a depth."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.bags.scenes import Scene
from fleetpose.evaluation.bench.bags.writing import BagWriter, Storage
from fleetpose.evaluation.metrics.geometry import Floats

DepthCoding = Literal["16UC1", "32FC1", "png 16UC1", "png 32FC1", "rvl"]
COLOUR, DEPTH = "color/image_raw", "aligned_depth_to_color/image_raw"
TRUTH = "ground_truth/pose"
_EXACT_M = 1e-6  # metres as float32
_NEAREST, _FURTHEST = 100.0, 10.0  # image_transport's defaults: depth_quantization, depth_max
QUANT_A = _NEAREST * (_NEAREST + 1.0)
QUANT_B = 1.0 - QUANT_A / _FURTHEST


@dataclass(frozen=True)
class Variant:
    """How a bag is written."""

    storage: Storage = "mcap"
    jpeg: bool = False
    depth: DepthCoding = "16UC1"
    packed: bool = False

    @property
    def name(self) -> str:
        """For tables."""
        parts = (self.storage, "jpeg" if self.jpeg else "rgb8", self.depth)
        return ", ".join((*parts, "zstd") if self.packed else parts)

    def quantum_m(self, depth_m: Floats) -> Floats:
        """By how much a depth may be off: nothing, or a step of the inverse depth."""
        exact = np.full_like(depth_m, _EXACT_M)
        return depth_m**2 / QUANT_A + _EXACT_M if self.depth == "png 32FC1" else exact


VARIANTS = (
    Variant(),
    Variant("sqlite3"),
    Variant("ros1"),
    Variant(packed=True),
    Variant("sqlite3", packed=True),
    Variant(jpeg=True),
    Variant(depth="32FC1"),
    Variant("ros1", jpeg=True, depth="png 16UC1"),
    Variant(jpeg=True, depth="png 32FC1"),
    Variant(depth="rvl"),
)


def write(path: Path, scene: Scene, variant: Variant, namespace: str, truth: bool = False) -> Path:
    """Writes a scene as a bag of a robot below a namespace; its true poses only if asked for."""
    at = f"{namespace}/camera"
    path = path.with_suffix(".bag") if variant.storage == "ros1" else path
    with BagWriter(path, variant.storage, variant.packed) as bag:
        for k, stamp_ns in enumerate(scene.stamps_ns):
            _put_colour(bag, f"{at}/{COLOUR}", scene.colours[k], variant.jpeg, stamp_ns)
            _put_depth(bag, f"{at}/{DEPTH}", scene.depths_mm[k], variant.depth, stamp_ns)
            bag.info(f"{at}/color/camera_info", scene.K, scene.size, stamp_ns)
            if truth:
                bag.pose(f"{namespace}/{TRUTH}", scene.T_world_cameras[k], stamp_ns)
    return path


def _put_colour(
    bag: BagWriter, topic: str, bgr: npt.NDArray[np.uint8], jpeg: bool, at_ns: int
) -> None:
    if jpeg:
        data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        bag.packed_image(f"{topic}/compressed", data, "rgb8; jpeg compressed bgr8", at_ns)
    else:
        bag.image(topic, bgr[..., ::-1], "rgb8", at_ns)


def _put_depth(
    bag: BagWriter, topic: str, mm: npt.NDArray[np.uint16], coding: DepthCoding, at_ns: int
) -> None:
    if coding == "16UC1":
        return bag.image(topic, mm, coding, at_ns)
    if coding == "32FC1":
        return bag.image(topic, _metres(mm), coding, at_ns)
    coders: dict[str, Callable[[], tuple[str, bytes]]] = {
        "png 16UC1": lambda: ("16UC1; compressedDepth png", _png(mm, 0.0, 0.0)),
        "png 32FC1": lambda: ("32FC1; compressedDepth png", _png(_inverse(mm), QUANT_A, QUANT_B)),
        "rvl": lambda: ("16UC1; compressedDepth rvl", _head(0.0, 0.0) + rvl(mm)),
    }
    form, data = coders[coding]()
    return bag.packed_image(f"{topic}/compressedDepth", data, form, at_ns)


def _metres(mm: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    return np.where(mm == 0, np.nan, mm / 1000.0).astype(np.float32)


def _head(a: float, b: float) -> bytes:
    return struct.pack("<iff", 0, a, b)


def _png(pixels: npt.NDArray[np.uint16], a: float, b: float) -> bytes:
    return _head(a, b) + cv2.imencode(".png", pixels)[1].tobytes()


def _inverse(mm: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
    """As compressed_depth_image_transport codes metres."""
    metres = np.maximum(mm, 1) / 1000.0
    return np.where(mm == 0, 0, QUANT_A / metres + QUANT_B).astype(np.uint16)


def rvl(mm: npt.NDArray[np.uint16]) -> bytes:
    """Width, height and depths as Wilson's RVL (2017): runs of zeros, then differences, by nibbles
    of three bits and one that says whether more follow.
    """
    pixels = mm.reshape(-1).astype(np.int64)
    edges = np.flatnonzero(np.diff(pixels != 0)) + 1
    runs = np.split(pixels, edges)
    if not len(runs) or runs[0][0] != 0:
        runs.insert(0, pixels[:0])
    nibbles: list[int] = []
    before = 0
    for k, run in enumerate(runs):
        _number(nibbles, len(run))
        if k % 2:
            for delta in np.diff(run, prepend=before).tolist():
                _number(nibbles, (delta << 1) ^ (delta >> 63))
            before = int(run[-1])
    if len(runs) % 2:
        _number(nibbles, 0)
    words = np.array([*nibbles, *[0] * (-len(nibbles) % 8)], np.uint32).reshape(-1, 8)
    shifts = np.arange(28, -1, -4, dtype=np.uint32)
    coded = (words << shifts).sum(axis=1, dtype=np.uint32)
    return struct.pack("<II", mm.shape[1], mm.shape[0]) + coded.astype("<u4").tobytes()


def _number(nibbles: list[int], value: int) -> None:
    while True:
        low, value = value & 7, value >> 3
        nibbles.append(low | (8 if value else 0))
        if not value:
            return
