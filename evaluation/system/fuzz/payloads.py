"""Malformed payloads: what noise, cut lines, old versions and ill will put on a wire.

Each maker takes a random generator and a good sample and returns a sample that is probably bad;
the caller checks that the receiver's own decoder refuses it.
"""

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import zstandard

from fleetpose.protocol.messages.base import MAX_MESSAGE_BYTES
from fleetpose.protocol.transport import Sample

Maker = Callable[[random.Random, Sample], Sample]
_JUNK: tuple[Any, ...] = (
    None,
    True,
    -1,
    2**63,
    2**64 - 1,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "\x1b[2J\r\n2026 ERROR forged",
    "../" * 20,
    b"\x00" * 64,
    [],
    {},
    [[]] * 50,
    {"a": 1},
    msgpack.ExtType(1, b""),
    msgpack.ExtType(42, b"x"),
)
_SCAN = b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00"  # the header of an empty scan
_BOMB = zstandard.ZstdCompressor(level=1).compress(bytes(200_000_000))
_ENDLESS = zstandard.ZstdCompressor(level=1, write_content_size=False).compress(bytes(50_000_000))


def noise(chance: random.Random, good: Sample) -> Sample:
    """Random bytes."""
    return replace(good, payload=chance.randbytes(chance.choice((0, 1, 7, 64, 1000))))


def cut(chance: random.Random, good: Sample) -> Sample:
    """The beginning of a good message."""
    return replace(good, payload=good.payload[: chance.randrange(max(len(good.payload), 1))])


def flipped(chance: random.Random, good: Sample) -> Sample:
    """A good message with a few flipped bits, most of them near its beginning."""
    damaged = bytearray(good.payload)
    for _ in range(chance.randint(1, 8)):
        end = min(len(damaged), chance.choice((60, 400, len(damaged))))
        damaged[chance.randrange(max(end, 1))] ^= 1 << chance.randrange(8)
    return replace(good, payload=bytes(damaged))


def longer(chance: random.Random, good: Sample) -> Sample:
    """A good message with something behind it."""
    return replace(good, payload=good.payload + chance.randbytes(chance.randint(1, 50)))


def oversize(chance: random.Random, good: Sample) -> Sample:
    """More bytes than are read of any message."""
    return replace(good, payload=bytes(MAX_MESSAGE_BYTES + 1 + chance.randrange(10)))


def other_version(chance: random.Random, good: Sample) -> Sample:
    """Good bytes under the name of another version or message."""
    encodings = (
        "application/msgpack;fleet.state.v9",
        good.encoding.rpartition(".")[0] + ".v0",
        "application/msgpack",
        "text/plain",
        "application/msgpack;" + "x" * 200,
        "image/png",
        "application/msgpack;\nforged log line",
    )
    return replace(good, encoding=chance.choice(encodings))


def wrong_field(chance: random.Random, good: Sample) -> Sample:
    """One field, at any depth, holds something else, is gone, or has a stranger beside it."""
    content = _content(good.payload)
    place: Any = content
    while isinstance(place, dict) and place:
        name = chance.choice(list(place))
        deed = chance.random()
        if isinstance(place[name], dict) and deed < 0.6:
            place = place[name]
            continue
        if deed < 0.15:
            del place[name]
        elif deed < 0.3:
            place["stranger\n" + "x" * chance.randrange(90)] = 1
        else:
            place[name] = chance.choice(_JUNK)
        break
    return replace(good, payload=msgpack.packb(content))


def not_finite(chance: random.Random, good: Sample) -> Sample:
    """Every array of numbers holds nan or inf somewhere; where there is none, every number does."""
    bad = chance.choice((np.nan, np.inf, -np.inf))

    def spoil(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: spoil(item) for name, item in value.items()}
        if isinstance(value, list):
            return [spoil(item) for item in value]
        if isinstance(value, msgpack.ExtType) and value.code == 1:
            return msgpack.ExtType(1, bytes(value.data)[:-8] + np.float64(bad).tobytes())
        return bad if isinstance(value, float) else value

    return replace(good, payload=msgpack.packb(spoil(_content(good.payload))))


def odd_array(chance: random.Random, good: Sample) -> Sample:
    """An array of a forbidden dtype, an impossible shape, or another size than it says."""
    headers = (["|O", [1]], ["<f8", [2**31, 2**31]], ["<f8", [-1]], ["<f8", [3] * 40], [], 7, "x")
    header: bytes = msgpack.packb(chance.choice(headers)) or b""
    array = msgpack.ExtType(1, header + chance.randbytes(8 * chance.randrange(4)))
    content = _content(good.payload)
    content[chance.choice(list(content))] = array
    return replace(good, payload=msgpack.packb(content))


def deep(chance: random.Random, good: Sample) -> Sample:
    """Lists or maps nested into each other without end."""
    opener = chance.choice((b"\x91", b"\x81\xa1a", b"\xdc\x00\x01"))
    return replace(good, payload=opener * chance.choice((500, 5000, 100_000)))


def many(chance: random.Random, good: Sample) -> Sample:
    """A million items, or a map of thousands of keys, where a few are expected."""
    content = _content(good.payload)
    name = chance.choice(list(content))
    if chance.random() < 0.7:
        content[name] = {f"k{k}": k for k in range(3000)}
    else:
        content[name] = [chance.choice((0, None, "", 1.5))] * 1_000_000
    return replace(good, payload=msgpack.packb(content))


def zstd_bomb(chance: random.Random, good: Sample) -> Sample:
    """A cloud or salient points that would unpack to 200 MB, with or without saying so."""
    content = _content(good.payload)
    part = content[chance.choice(("cloud", "salient"))]
    part["data"] = chance.choice((_BOMB, _ENDLESS))
    if chance.random() < 0.3 and "width" in part:
        part["width"] = part["height"] = 16384
    return replace(good, payload=msgpack.packb(content))


def jpeg_bomb(chance: random.Random, good: Sample) -> Sample:
    """A few bytes that declare an image of gigabytes, or hundreds of scans."""
    head, rest = _around_frame(good.payload)
    if chance.random() < 0.5:
        side = chance.choice((30_000, 65_535)).to_bytes(2, "big")
        return replace(good, payload=head + side + side + rest[4:])
    scan = good.payload.find(b"\xff\xda")
    return replace(good, payload=good.payload[:scan] + _SCAN * 300 + good.payload[scan:])


def bad_header(chance: random.Random, good: Sample) -> Sample:
    """A JPEG whose attachment is none, damaged, or of another view."""
    header = good.attachment or b""
    attachments = (None, b"", chance.randbytes(30), header[:-3], header + bytes(1))
    return replace(good, attachment=chance.choice(attachments))


def _content(payload: bytes) -> dict[str, Any]:
    return msgpack.unpackb(payload, strict_map_key=False)


def _around_frame(jpeg: bytes) -> tuple[bytes, bytes]:
    """What lies before and after the start of the height in the frame header."""
    at = next(at for m in (0xC0, 0xC1, 0xC2) if (at := jpeg.find(bytes((0xFF, m)))) > 0)
    return jpeg[: at + 5], jpeg[at + 5 :]


MESSAGE_KINDS: dict[str, tuple[Maker, int]] = {
    "noise": (noise, 4),
    "cut": (cut, 4),
    "flipped bits": (flipped, 6),
    "longer": (longer, 2),
    "oversize": (oversize, 0),
    "other version": (other_version, 3),
    "wrong field": (wrong_field, 6),
    "not finite": (not_finite, 2),
    "odd array": (odd_array, 2),
    "deep": (deep, 1),
    "many items": (many, 1),
}
"""For every kind of message, with its share; weight 0: a few only, they are large."""
VIEW_KINDS = {**MESSAGE_KINDS, "zstd bomb": (zstd_bomb, 4)}
IMAGE_KINDS: dict[str, tuple[Maker, int]] = {
    "noise": (noise, 2),
    "cut": (cut, 2),
    "oversize": (oversize, 0),
    "other version": (other_version, 1),
    "jpeg bomb": (jpeg_bomb, 4),
    "bad header": (bad_header, 2),
}
