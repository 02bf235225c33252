"""How large a packed image says that it is, before anybody unpacks it: decoders believe it."""

import struct

LARGEST_PX = 50_000_000
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_ALONE = frozenset((0x01, 0xFF, *range(0xD0, 0xD9)))  # markers without a length


def declared_px(data: bytes) -> int:
    """Pixels of a PNG, or of the largest frame of a JPEG; 0 of anything else, and of what is cut
    off before.
    """
    if data.startswith(_PNG) and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width * height
    return _of_jpeg(data) if data.startswith(_JPEG) else 0


def longest_chunk(data: bytes) -> int:
    """Bytes of the longest chunk that a PNG says it has, up to the first that is cut off; 0 of
    anything else.
    """
    at, longest = len(_PNG), 0
    while data.startswith(_PNG) and at + 8 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        longest = max(longest, length)
        at += 12 + length
    return longest


def _of_jpeg(data: bytes) -> int:
    """Decoders skip what they do not understand: so does this, and takes no frame for the last."""
    at, most = 2, 0
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 9:
        marker = data[at + 1]
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            most = max(most, width * height)
        if marker == 0xDA:  # the image itself
            break
        skipped = 1 if marker in _ALONE or not marker else 2 + (data[at + 2] << 8 | data[at + 3])
        at += skipped
    return most
