"""Messages to bytes and back: msgpack with numpy arrays, never pickle.

Any bytes become either a valid message or one `CodecError`. Sizes are bounded before and after
decompression.
"""

from typing import Any, TypeVar, cast

import msgpack
import numpy as np
import zstandard
from pydantic import ValidationError

from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages.base import MAX_MESSAGE_BYTES, Message

MAX_DECOMPRESSED_BYTES = 64 * 1024 * 1024
MAX_ITEMS = 2_000_000  # of all lists and maps in a message: a few bytes each, but many in memory
MAX_KEYS = 1024  # of one map
MAX_RANK = 4
_ARRAY = 1  # msgpack extension type: (dtype string, shape, raw bytes)
_DTYPES = frozenset({"<f8", "<f4", "<i8", "<i4", "<i2", "|i1", "<u8", "<u4", "<u2", "|u1", "|b1"})

M = TypeVar("M", bound=Message)


def encoding_of(message_type: type[Message]) -> str:
    """The zenoh encoding of a message and its version: `application/msgpack;fleet.pose.v1`."""
    return f"application/msgpack;{message_type.schema_name}"


def schemas_read(message_type: type[Message]) -> tuple[str, ...]:
    """This version and the one before: `("fleet.pose.v2", "fleet.pose.v1")`."""
    names = (message_type.schema_name, message_type.schema_before)
    return tuple(name for name in names if name is not None)


def _readable(message_type: type[Message]) -> tuple[str, ...]:
    return tuple(f"application/msgpack;{name}" for name in schemas_read(message_type))


def pack(message: Message) -> bytes:
    """Encodes a message of `protocol.messages`."""
    return cast(bytes, msgpack.packb(message.model_dump(), default=_pack_array, use_bin_type=True))


def unpack(message_type: type[M], payload: bytes, encoding: str | None = None) -> M:
    """Decodes and validates a message.

    Args:
        message_type: the expected message class.
        payload: the bytes received.
        encoding: the encoding they came with; checked when it names a schema.

    Raises:
        CodecError: the bytes are no such message, for whatever reason.
    """
    if encoding is not None and encoding not in _readable(message_type):
        raise CodecError(f"encoding '{encoding[:80]}', expected '{encoding_of(message_type)}'")
    if len(payload) > message_type.at_most:
        raise CodecError(f"{len(payload)} bytes, at most {message_type.at_most} are read")
    try:
        content = _unpacked(payload)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, MemoryError) as error:
        raise CodecError(f"not msgpack: {type(error).__name__} {str(error)[:120]}") from error
    except msgpack.exceptions.UnpackException as error:
        raise CodecError(f"not msgpack: {type(error).__name__}") from error
    if not isinstance(content, dict):
        raise CodecError(f"a map was expected, not {type(content).__name__}")
    try:
        return message_type.model_validate(content)
    except ValidationError as error:
        raise CodecError(f"{message_type.__name__}.{_first_fault(error)}") from error
    except (ValueError, TypeError, OverflowError, RecursionError, MemoryError) as error:
        raise CodecError(f"{message_type.__name__}: {str(error)[:120]}") from error


def _unpacked(payload: bytes) -> Any:
    """The content, with a bound on the number of its items: lists nested in lists cost one byte
    each on the wire.
    """
    left = MAX_ITEMS

    def counted(items: Any) -> Any:
        nonlocal left
        left -= len(items) + 1
        if left < 0:
            raise CodecError(f"more than {MAX_ITEMS} items")
        return items

    return msgpack.unpackb(
        payload,
        ext_hook=_unpack_array,
        list_hook=counted,
        object_hook=counted,
        raw=False,
        strict_map_key=True,
        use_list=False,
        max_map_len=MAX_KEYS,
    )


def _first_fault(error: ValidationError) -> str:
    """Which field is wrong and how; numbers of list items are left out."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    place = ".".join(part for part in first["loc"] if isinstance(part, str))
    if first["type"] == "extra_forbidden":
        return f"a field '{place[:60]}' that is not known"
    return f"{place[:60]}: {first['msg'][:200]}"


def _pack_array(value: Any) -> msgpack.ExtType:
    if isinstance(value, np.generic):
        value = np.asarray(value)
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        raise TypeError(f"{type(value).__name__} does not go on the wire")
    little = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
    header = cast(bytes, msgpack.packb((little.dtype.str, list(value.shape))))
    return msgpack.ExtType(_ARRAY, header + little.tobytes())


def _unpack_array(code: int, data: bytes) -> np.ndarray:
    if code != _ARRAY:
        raise CodecError(f"unknown msgpack extension {code}")
    unpacker = msgpack.Unpacker(use_list=False, max_buffer_size=MAX_MESSAGE_BYTES)
    unpacker.feed(data)
    header = unpacker.unpack()
    if not isinstance(header, tuple) or len(header) != 2:
        raise CodecError("array without header")
    name, shape = header
    if name not in _DTYPES:
        raise CodecError(f"array of dtype {str(name)[:20]} is refused")
    if (
        not isinstance(shape, tuple)
        or len(shape) > MAX_RANK
        or not all(type(n) is int and 0 <= n < 2**32 for n in shape)
    ):
        raise CodecError("array of an impossible shape")
    body = data[unpacker.tell() :]
    dtype = np.dtype(name)
    count = 1
    for n in shape:
        count *= n
    if count * dtype.itemsize != len(body):
        raise CodecError(f"array of shape {shape} has {len(body)} bytes")
    return np.frombuffer(body, dtype).reshape(shape)


def compress(data: bytes) -> bytes:
    """zstd level 1: on depth and descriptors as small as level 3, and up to three times as fast.

    The content size is in the frame, so that `decompress` can refuse bombs unread.
    """
    return zstandard.ZstdCompressor(level=1).compress(data)


def decompress(data: bytes, expected_bytes: int) -> bytes:
    """Undoes `compress`.

    Raises:
        CodecError: the frame is damaged, or states another size than expected.
    """
    if not 0 <= expected_bytes <= MAX_DECOMPRESSED_BYTES:
        raise CodecError(f"{expected_bytes} bytes after decompression are refused")
    try:
        if zstandard.frame_content_size(data) != expected_bytes:
            raise CodecError(f"compressed block does not hold the {expected_bytes} bytes it should")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=expected_bytes)
    except zstandard.ZstdError as error:
        raise CodecError(f"damaged zstd block: {error}") from error
