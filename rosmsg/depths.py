"""Depth images: raw, as PNG, and as `compressedDepth` (PNG or RVL), in metres."""

import struct
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg import rvl
from fleetpose.rosmsg.images import decoded, is_compressed, raw_image

Depth = npt.NDArray[np.float32]

MM_PER_M = 1000.0
NO_DEPTH = 65535
_HEADER = struct.Struct("<iff")  # of compressedDepth: kind of coding, A, B
_RVL_SIZE = struct.Struct("<II")  # width, height


def depth_m(message: Any) -> Depth:
    """(H, W) float32 metres along the optical axis, nan where there is none: 0, nan, infinite, and
    65535 of 16 bits.

    Raises:
        CodecError: it is no depth image, or damaged.
    """
    if is_compressed(message):
        return _of_compressed(message)
    raw = raw_image(message)
    if raw.ndim != 2 or raw.dtype == np.uint8:
        raise CodecError(f"an image of encoding '{message.encoding}' holds no depths")
    return _of_metres(raw) if raw.dtype == np.float32 else _of_millimetres(raw)


def _of_compressed(message: Any) -> Depth:
    encoding, _, how = (part.strip() for part in message.format.partition(";"))
    if "compressedDepth" not in how:
        return _of_millimetres(decoded(message.data, cv2.IMREAD_UNCHANGED, message.format))
    data = bytes(message.data)
    if len(data) <= _HEADER.size:
        raise CodecError(f"a compressedDepth image of {len(data)} bytes")
    _, a, b = _HEADER.unpack_from(data)
    body = data[_HEADER.size :]
    if "rvl" in how.lower():
        raw = rvl.decoded(body[_RVL_SIZE.size :], *_RVL_SIZE.unpack_from(body.ljust(8, b"\0")))
    else:
        buffer = np.frombuffer(body, np.uint8)
        raw = decoded(buffer, cv2.IMREAD_UNCHANGED, message.format)
    return _of_inverse(raw, a, b) if encoding == "32FC1" else _of_millimetres(raw)


def _of_millimetres(raw: npt.NDArray[Any]) -> Depth:
    _check_sixteen(raw)
    depth = raw.astype(np.float32)
    depth /= np.float32(MM_PER_M)
    depth[(raw == 0) | (raw == NO_DEPTH)] = np.nan
    return depth


def _of_metres(raw: npt.NDArray[Any]) -> Depth:
    depth = np.array(raw, np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def _of_inverse(raw: npt.NDArray[Any], a: float, b: float) -> Depth:
    """Inverse depths in steps: `depth = A / (q - B)` (compressed_depth_image_transport)."""
    _check_sixteen(raw)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32(a) / (raw.astype(np.float32) - np.float32(b))
    depth[(raw == 0) | ~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def _check_sixteen(raw: npt.NDArray[Any]) -> None:
    if raw.ndim != 2 or raw.dtype != np.uint16:
        raise CodecError(f"a depth image of {raw.dtype} {raw.shape} instead of 16 bits")
