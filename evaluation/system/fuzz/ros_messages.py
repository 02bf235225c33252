"""Good messages of ROS, and ways to damage them: what a broken driver, disk or radio leaves."""

import random
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from fleetpose.evaluation.system.ros import messages
from fleetpose.rosmsg.bag import Topic

SIZE = WIDTH, HEIGHT = 96, 72
K = np.array(((80.0, 0, 47.5), (0, 80.0, 35.5), (0, 0, 1)))
OPTICAL, BASE = "optical", "base_link"
STAMP_NS = 1_700_000_000 * 10**9
_T_BASE_OPTICAL = np.array(((0, 0, 1, 0.2), (-1, 0, 0, 0), (0, -1, 0, 1.0), (0, 0, 0, 1.0)))
_SIDES = (30_000, 65_535, 2**31 - 1)
_WORDS = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", bytes(4))

Damage = Callable[[random.Random, bytes], bytes]


@dataclass(frozen=True)
class Robot:
    """Topics that make a camera, with a good message of each, coded.

    Attributes:
        types: by topic.
        raw: by topic.
    """

    types: dict[str, str]
    raw: dict[str, bytes]

    @property
    def topics(self) -> tuple[Topic, ...]:
        return tuple(Topic(name, type, 1) for name, type in self.types.items())


def robots(seed: int = 0) -> dict[str, Robot]:
    """One of each form: raw and packed depth images, two eyes, a cloud."""
    rng = np.random.default_rng(seed)
    colour = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8), (0, 0), 1.0)
    depth = rng.integers(800, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
    image = messages.image(colour, "bgr8", OPTICAL)
    jpeg = _packed(".jpg", colour, "rgb8; jpeg compressed bgr8")
    deep = messages.image(depth, "16UC1", OPTICAL)
    png = _packed(".png", depth, "16UC1; compressedDepth png", struct.pack("<iff", 0, 0, 0))
    eye, info = messages.image(colour[..., 0], "mono8", OPTICAL), messages.info(K, SIZE, OPTICAL)
    right = messages.info(K, SIZE, OPTICAL)
    right.p[3] = -0.1 * K[0, 0]
    colours = {"/c/image_raw": image, "/c/camera_info": info}
    packed = {"/c/image_raw/compressed": jpeg, "/c/camera_info": info}
    return {
        "raw": _robot(colours | {"/depth/image_raw": deep}),
        "packed": _robot(packed | {"/depth/image_raw/compressedDepth": png}),
        "rvl": _robot(packed | {"/depth/image_raw/compressedDepth": _rvl(depth)}),
        "eyes": _robot(
            {
                "/left/image_rect": eye,
                "/left/camera_info": info,
                "/right/image_rect": eye,
                "/right/camera_info": right,
            }
        ),
        "cloud": _robot(colours | {"/points": _cloud(depth)}),
    }


def _robot(own: dict[str, Any]) -> Robot:
    fixed = messages.transforms((BASE, OPTICAL, _T_BASE_OPTICAL))
    said = own | {
        "/tf_static": fixed,
        "/tf": messages.transforms(("odom", BASE, np.eye(4))),
        "/odom": messages.odometry(np.eye(4), "odom", BASE),
        "/imu": messages.imu(np.array((0.0, 0.0, 9.81)), BASE),
    }
    raw = {}
    for topic, message in said.items():
        coded = messages.coded(message)
        of_tf = topic.startswith("/tf")
        at = messages.TRANSFORM_STAMP_AT if of_tf else messages.STAMP_AT
        messages.stamp(coded, STAMP_NS, at)
        raw[topic] = bytes(coded)
    return Robot({topic: message.__msgtype__ for topic, message in said.items()}, raw)


def _packed(suffix: str, array: Any, form: str, header: bytes = b"") -> Any:
    data = np.frombuffer(header + cv2.imencode(suffix, array)[1].tobytes(), np.uint8)
    head = messages.header(OPTICAL)
    return messages.of("sensor_msgs/CompressedImage", header=head, format=form, data=data)


def _rvl(depth: Any) -> Any:
    """One run of all pixels, without differences: an image of one depth."""
    numbers = [0, depth.size, 2 * 1500, *[0] * (depth.size - 1)]
    nibbles: list[int] = []
    for number in numbers:
        while number > 7:
            nibbles.append(number & 7 | 8)
            number >>= 3
        nibbles.append(number)
    nibbles += [0] * (-len(nibbles) % 8)
    words = np.array(nibbles, np.uint32).reshape(-1, 8) << np.arange(28, -4, -4, dtype=np.uint32)
    body = struct.pack("<iffII", 0, 0, 0, *SIZE) + words.sum(1).astype("<u4").tobytes()
    data, form = np.frombuffer(body, np.uint8), "16UC1; compressedDepth rvl"
    head = messages.header(OPTICAL)
    return messages.of("sensor_msgs/CompressedImage", header=head, format=form, data=data)


def _cloud(depth: Any) -> Any:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    z = depth / 1000
    xyz = np.stack(((u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z), axis=-1)
    fields = [
        messages.of("sensor_msgs/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate("xyz")
    ]
    return messages.of(
        "sensor_msgs/PointCloud2",
        header=messages.header(OPTICAL),
        height=HEIGHT,
        width=WIDTH,
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * WIDTH,
        data=xyz.astype(np.float32).view(np.uint8).reshape(-1),
        is_dense=True,
    )


def noise(chance: random.Random, good: bytes) -> bytes:
    """Random bytes, some behind CDR's four."""
    head = good[:4] if chance.random() < 0.7 else b""
    return head + chance.randbytes(chance.choice((0, 1, 7, 64, 1000)))


def cut(chance: random.Random, good: bytes) -> bytes:
    """The beginning of a good message."""
    return good[: chance.randrange(max(len(good), 1))]


def flipped(chance: random.Random, good: bytes) -> bytes:
    """A few flipped bits, most of them near the beginning."""
    damaged = bytearray(good)
    for _ in range(chance.randint(1, 8)):
        end = min(len(damaged), chance.choice((60, 400, len(damaged))))
        damaged[chance.randrange(max(end, 1))] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def longer(chance: random.Random, good: bytes) -> bytes:
    """Something behind a good message."""
    return good + chance.randbytes(chance.randint(1, 50))


def word(chance: random.Random, good: bytes) -> bytes:
    """A length, a size, a number that cannot be: four bytes near the beginning."""
    damaged = bytearray(good)
    at = 4 * chance.randrange(max(min(len(good), chance.choice((120, 600))) // 4, 1))
    damaged[at : at + 4] = chance.choice((*_WORDS, chance.randbytes(4)))
    return bytes(damaged)


def number(chance: random.Random, good: bytes) -> bytes:
    """Eight bytes near the beginning are nan, infinite, or very large."""
    damaged = bytearray(good)
    at = 4 + 8 * chance.randrange(max(min(len(good), 600) // 8, 1))
    value = chance.choice((float("nan"), float("inf"), 1e300, -1e300, 1e-300, 0.0))
    damaged[at : at + 8] = struct.pack("<d", value)
    return bytes(damaged)


def bomb(chance: random.Random, good: bytes) -> bytes:
    """A packed image that says it is of gigapixels; others are cut."""
    side = chance.choice(_SIDES)
    if (at := good.find(b"IHDR")) > 0:
        head = b"IHDR" + struct.pack(">II", side, side) + good[at + 12 : at + 17]
        return good[:at] + head + struct.pack(">I", zlib.crc32(head)) + good[at + 21 :]
    if (at := good.find(b"\xff\xc0")) > 0:
        tall = struct.pack(">HH", side & 0xFFFF, 0xFFFF)
        return good[: at + 5] + tall + good[at + 9 :]
    if (at := good.find(struct.pack("<II", *SIZE))) > 0:
        side = chance.choice((side, 16_384))
        return good[:at] + struct.pack("<II", side, side) + good[at + 8 :]
    return cut(chance, good)


DAMAGES: dict[str, tuple[Damage, int]] = {
    "noise": (noise, 2),
    "cut": (cut, 4),
    "flipped bits": (flipped, 6),
    "longer": (longer, 1),
    "word": (word, 8),
    "number": (number, 4),
    "bomb": (bomb, 3),
}
"""With their shares."""


def damaged(chance: random.Random, good: bytes) -> tuple[str, bytes]:
    """A kind of damage, and what it makes of a message."""
    [kind] = chance.choices(list(DAMAGES), [share for _, share in DAMAGES.values()])
    return kind, DAMAGES[kind][0](chance, good)
