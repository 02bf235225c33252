"""What a JPEG says about itself, read before anything is decoded.

A few bytes can declare an image of gigabytes. The size is therefore read from the frame header, as
the decoder would, and refused before memory is taken.
"""

from dataclasses import dataclass

from fleetpose.hmi_client.errors import PictureError
from fleetpose.protocol.messages import Camera

MAX_PIXELS = 40_000_000
MAX_CAMERA_PX = 16384  # as in `protocol.messages.Camera`
MAX_SCANS = 200  # a progressive image has about ten
MAX_SCANNED_PIXELS = 10 * MAX_PIXELS  # each scan costs a walk over all pixels
_SOI, _EOI, _START_OF_SCAN = 0xD8, b"\xff\xd9", 0xDA
_READABLE_FRAMES = (0xC0, 0xC1, 0xC2)  # baseline, extended, progressive
_OTHER_FRAMES = frozenset(range(0xC0, 0xD0)) - {*_READABLE_FRAMES, 0xC4, 0xC8, 0xCC}
_BARE = frozenset((0x01, *range(0xD0, 0xD8)))  # markers without a length


@dataclass(frozen=True)
class Frame:
    """Size in pixels and number of channels: 1 is grey, 3 colours, 4 colours for print."""

    width: int
    height: int
    channels: int


def frame_of(jpeg: bytes) -> Frame:
    """Reads the header of a JPEG and looks for its end.

    Raises:
        PictureError: these bytes are no JPEG, not a whole one, or one that is too large to show.
    """
    if jpeg[:2] != bytes((0xFF, _SOI)):
        raise PictureError("these bytes are no JPEG")
    frame, at = None, 2
    while at + 4 <= len(jpeg):
        marker = jpeg[at + 1]
        if jpeg[at] != 0xFF:
            raise PictureError("its header is damaged")
        if marker == 0xFF or marker in _BARE:  # a fill byte, or a marker without content
            at += 1 if marker == 0xFF else 2
            continue
        length = int.from_bytes(jpeg[at + 2 : at + 4], "big")
        if marker in _OTHER_FRAMES:
            raise PictureError("this kind of JPEG is not read: use baseline or progressive")
        if marker in _READABLE_FRAMES:
            frame = _frame(jpeg[at + 4 : at + 2 + length])
        if marker == _START_OF_SCAN:
            return _whole(jpeg, at, frame)
        at += 2 + max(length, 2)
    raise PictureError("it is cut off before its pixels")


def check_size(width: int, height: int, scale: int, camera: Camera | None) -> None:
    """Checks that an image of this size, enlarged by its scale, is one of the camera.

    Args:
        width, height: of the image, px.
        scale: full-resolution pixels per image pixel.
        camera: of the robot that sent it; none: not known yet, then a size that no camera has is
            refused.

    Raises:
        PictureError: it is not; a pixel picked in it would be another one in the robot's view.
    """
    full = (width * scale, height * scale)
    if camera is None:
        if max(full) > MAX_CAMERA_PX:
            raise PictureError(f"{width}x{height} px at scale {scale} are of no camera")
        return
    wanted = (camera.width, camera.height)
    if any(abs(a - b) >= scale for a, b in zip(full, wanted, strict=True)):
        raise PictureError(
            f"{width}x{height} px at scale {scale} do not fit the camera's "
            f"{camera.width}x{camera.height} px"
        )


def _frame(content: bytes) -> Frame:
    if len(content) < 6:
        raise PictureError("its header is damaged")
    height, width = (int.from_bytes(content[k : k + 2], "big") for k in (1, 3))
    frame = Frame(width, height, content[5])
    if not width or not height or frame.channels not in (1, 3, 4):
        raise PictureError(f"an image of {width}x{height} px, {frame.channels} channels is none")
    if width * height > MAX_PIXELS:
        raise PictureError(
            f"{width}x{height} px are too many, {MAX_PIXELS // 10**6} million are shown at most"
        )
    return frame


def _whole(jpeg: bytes, scan: int, frame: Frame | None) -> Frame:
    if frame is None:
        raise PictureError("its header is damaged")
    if jpeg.find(_EOI, scan) < 0:  # coded pixels never hold these two bytes
        raise PictureError("it is cut off: the end is missing")
    scans = jpeg.count(bytes((0xFF, _START_OF_SCAN)), scan)
    if scans > MAX_SCANS or scans * frame.width * frame.height > MAX_SCANNED_PIXELS:
        raise PictureError("it has too many scans")
    return frame
