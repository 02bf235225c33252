"""`sensor_msgs/Image` and `CompressedImage` as arrays."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg.sizes import LARGEST_PX, declared_px, longest_chunk

Image = npt.NDArray[np.uint8]

_FORMS: dict[str, tuple[type[np.generic], int]] = {  # type and channels by encoding
    **dict.fromkeys(("mono8", "8UC1"), (np.uint8, 1)),
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), (np.uint8, 3)),
    **dict.fromkeys(("rgba8", "bgra8", "8UC4"), (np.uint8, 4)),
    **dict.fromkeys(("mono16", "16UC1"), (np.uint16, 1)),
    **dict.fromkeys(("rgb16", "bgr16"), (np.uint16, 3)),
    **dict.fromkeys(("yuv422", "uyvy", "yuv422_yuy2", "yuyv"), (np.uint8, 2)),
    **{f"bayer_{order}8": (np.uint8, 1) for order in ("rggb", "bggr", "gbrg", "grbg")},
    **{f"bayer_{order}16": (np.uint16, 1) for order in ("rggb", "bggr", "gbrg", "grbg")},
    "32FC1": (np.float32, 1),
}
_TO_BGR = {
    "rgb": cv2.COLOR_RGB2BGR,
    "rgba": cv2.COLOR_RGBA2BGR,
    "bgra": cv2.COLOR_BGRA2BGR,
    "mono": cv2.COLOR_GRAY2BGR,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    # OpenCV names the second row's second and third pixel, ROS the first row's first two
    "bayer_rggb": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}
_NAMES = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC1": "mono16"}


def is_compressed(message: Any) -> bool:
    """Whether it is a `CompressedImage`."""
    return hasattr(message, "format")


def raw_image(message: Any) -> npt.NDArray[Any]:
    """An `Image` as it is coded: (H, W) or (H, W, channels), in this machine's order of bytes.

    Raises:
        CodecError: its encoding is not known, or it is shorter than its size asks for.
    """
    if message.encoding not in _FORMS:
        raise CodecError(f"images of encoding '{message.encoding}' are not supported")
    kind, channels = _FORMS[message.encoding]
    coded = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * coded.itemsize
    if not height or not width or step < row or len(message.data) < step * height:
        raise CodecError(
            f"an image {width}x{height} {message.encoding} with rows of {step} bytes, "
            f"{len(message.data)} bytes in all"
        )
    rows = np.asarray(message.data, np.uint8)[: step * height].reshape(height, step)[:, :row]
    shape = (height, width, channels) if channels > 1 else (height, width)
    return np.ascontiguousarray(rows).view(coded).reshape(shape).astype(kind, copy=False)


def bgr(message: Any) -> Image:
    """An image of colours, or a grey one, as (H, W, 3) uint8 BGR.

    Raises:
        CodecError: it cannot be read.
    """
    if is_compressed(message):
        return _decompressed(message)
    if message.encoding == "32FC1":
        raise CodecError("an image of encoding '32FC1' is one of depths, not of colours")
    return _as_bgr(raw_image(message), str(_NAMES.get(message.encoding, message.encoding)))


def grey_or_bgr(message: Any) -> Image:
    """The same, but a grey image stays (H, W)."""
    if not is_compressed(message) and message.encoding in ("mono8", "8UC1"):
        return np.asarray(raw_image(message), np.uint8)
    return bgr(message)


def _decompressed(message: Any) -> Image:
    """A JPEG or PNG. Its writers hand BGR to the codec whatever the source was; the pattern of a
    sensor's filter alone is left to the reader.
    """
    source = message.format.partition(";")[0].strip()
    bayer = source.startswith("bayer_")
    flags = cv2.IMREAD_GRAYSCALE if bayer else cv2.IMREAD_COLOR
    image = decoded(message.data, flags | cv2.IMREAD_IGNORE_ORIENTATION, message.format)
    return _as_bgr(image, source) if bayer else np.asarray(image, np.uint8)


def decoded(data: Any, flags: int, form: str) -> npt.NDArray[Any]:
    """What an image codec makes of bytes.

    Raises:
        CodecError: nothing.
    """
    buffer = np.asarray(data, np.uint8)
    raw = buffer.tobytes()
    if (pixels := declared_px(raw)) > LARGEST_PX or longest_chunk(raw) > len(raw):
        raise CodecError(
            f"a compressed image '{form}' says that it has {pixels} pixels, or a part that is "
            f"longer than its {len(raw)} bytes"
        )
    try:
        image = cv2.imdecode(buffer, flags) if buffer.size else None
    except cv2.error as error:
        raise CodecError(f"a compressed image '{form}' cannot be decoded: {error.err}") from error
    if image is None:
        raise CodecError(f"a compressed image '{form}' cannot be decoded")
    return np.asarray(image)


def _as_bgr(image: npt.NDArray[Any], encoding: str) -> Image:
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
        encoding = encoding.removesuffix("16")
    name = encoding.removesuffix("8")
    if name == "bgr":
        return np.asarray(image, np.uint8)
    return np.asarray(cv2.cvtColor(image, _TO_BGR[name]), np.uint8)
