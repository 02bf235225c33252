"""Packed images that say more of themselves than they have."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg.images import decoded
from fleetpose.rosmsg.sizes import declared_px

IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_size_is_known_before_anything_is_unpacked(suffix):
    data = cv2.imencode(suffix, IMAGE)[1].tobytes()
    assert declared_px(data) == 64 * 48
    assert decoded(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR, suffix).shape == IMAGE.shape
    assert declared_px(data[:20]) == 0 and declared_px(b"") == 0


def test_gigapixels_and_chunks_that_are_not_there_are_refused():
    png = cv2.imencode(".png", IMAGE)[1].tobytes()
    head = b"IHDR" + struct.pack(">II", 30_000, 30_000) + png[24:29]
    large = png[:12] + head + struct.pack(">I", zlib.crc32(head)) + png[33:]
    at = png.find(b"IDAT") - 4
    long = png[:at] + struct.pack(">I", 2**31 - 1) + png[at + 4 :]
    jpeg = cv2.imencode(".jpg", IMAGE)[1].tobytes()
    at = jpeg.find(b"\xff\xc0") + 5
    wide = jpeg[:at] + b"\xff\xff\xff\xff" + jpeg[at + 4 :]
    for data in (large, long, wide):
        with pytest.raises(CodecError, match="says that it has"):
            decoded(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR, "png")
