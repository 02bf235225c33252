"""Points as PLY files (Turk 1994): read from text and both binary orders, written little-endian.

Own code: Open3D writes further properties of a vertex but no remarks, and is large; plyfile's
licence would be everybody's.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.formats.arrays import FormatError

MOST_POINTS = 20_000_000  # a file that claims more is damaged
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_NAMES = {kind: name for name, kind in reversed(_TYPES.items())}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, eq=False)
class Ply:
    """The vertices of a file, a structured array (N,), and its remarks."""

    vertices: npt.NDArray[Any]
    comments: tuple[str, ...] = ()


def write_ply(path: Path, vertices: npt.NDArray[Any], comments: Sequence[str] = ()) -> None:
    """Writes a structured array (N,) of numbers, each field a property.

    Raises:
        FormatError: a field has a type that PLY does not know, or a remark several lines.
        OSError: it cannot be written.
    """
    fields = [(name, vertices.dtype[name].str[1:]) for name in vertices.dtype.names or ()]
    for name, kind in fields:
        if kind not in _NAMES:
            raise FormatError(f"property {name} of a vertex has type {kind}, which PLY has not")
    if any("\n" in comment for comment in comments):
        raise FormatError("a remark of a PLY file is one line")
    header = (
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {len(vertices)}",
        *(f"property {_NAMES[kind]} {name}" for name, kind in fields),
        "end_header",
    )
    packed = np.dtype([(name, f"<{kind}") for name, kind in fields])
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(vertices.astype(packed).tobytes())


def read_ply(path: Path) -> Ply:
    """The vertices, which must come first, and the remarks.

    Raises:
        FormatError: it is no such file, or cut off.
        OSError: it cannot be read.
    """
    content = path.read_bytes()
    head, end, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not end:
        raise FormatError("no PLY header")
    body = body[body.find(b"\n") + 1 :]
    text = head.decode("ascii", "replace").splitlines()
    lines = [line.split() for line in text]
    form = next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), "none")
    count, fields = _vertices(lines)
    comments = tuple(line.removeprefix("comment ") for line in text if line.startswith("comment "))
    if form == "ascii":
        return Ply(_from_text(body, count, fields), comments)
    if form not in _ORDERS:
        raise FormatError(f"format '{form}' is none of PLY's")
    dtype = np.dtype([(name, _ORDERS[form] + kind) for name, kind in fields])
    if len(body) < count * dtype.itemsize:
        whole = len(body) // max(dtype.itemsize, 1)
        raise FormatError(f"it is cut off: {whole} of {count} points")
    return Ply(np.frombuffer(body, dtype, count), comments)


def _vertices(lines: list[list[str]]) -> tuple[int, list[tuple[str, str]]]:
    """How many vertices, and their properties with types; vertices must come first."""
    first = next((k for k, line in enumerate(lines) if line[:1] == ["element"]), None)
    if first is None or lines[first][1:2] != ["vertex"] or len(lines[first]) != 3:
        raise FormatError("its first element is not 'vertex'")
    fields = []
    for line in lines[first + 1 :]:
        if line[:1] == ["element"]:
            break
        if line[:1] == ["property"]:
            if len(line) != 3 or line[1] not in _TYPES:
                raise FormatError(f"property {' '.join(line[1:])} of a vertex is not supported")
            fields.append((line[2], _TYPES[line[1]]))
    count = int(lines[first][2])
    if not 0 <= count <= MOST_POINTS:
        raise FormatError(f"it claims {count} points")
    return count, fields


def _from_text(body: bytes, count: int, fields: list[tuple[str, str]]) -> npt.NDArray[Any]:
    vertices = np.zeros(count, np.dtype(fields))
    if count:
        table = np.loadtxt(io.BytesIO(body), np.float64, max_rows=count, ndmin=2)
        if table.shape != (count, len(fields)):
            raise FormatError(f"it is cut off: {len(table)} of {count} points")
        for k, (name, _) in enumerate(fields):
            vertices[name] = table[:, k]
    return vertices
