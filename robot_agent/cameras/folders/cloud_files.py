"""Point clouds in files: PLY, PCD, and NumPy's npz and npy.

Own readers, since the libraries that read these formats are large (Open3D) or not free enough for
a robot that has neither. What they do not read they name.
"""

import io
import re
import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError

Floats = npt.NDArray[np.float64]

ENDINGS = (".ply", ".pcd", ".npz", ".npy")
MOST_POINTS = 20_000_000  # a file that claims more is damaged
_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_NAMES = ("xyz", "points", "xyz_cam", "cloud", "arr_0")  # of an npz's points, the first that is


def read_points(path: Path) -> Floats:
    """Points (N, 3), or (H, W, 3) of an organised cloud, as the file holds them; what is not finite
    is no measurement.

    Raises:
        DataFolderError: it cannot be read, or holds no points; the text says what is wrong.
    """
    readers = {".ply": _read_ply, ".pcd": _read_pcd, ".npz": _read_numpy, ".npy": _read_numpy}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise DataFolderError(f"{path} is no cloud that can be read: {', '.join(ENDINGS)}")
    try:
        points = reader(path)
    except (OSError, ValueError, TypeError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise DataFolderError(f"{path} cannot be read as a cloud: {error}") from error
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise DataFolderError(f"{path} holds an array {points.shape}, need (N, 3) or (H, W, 3)")
    return points


def _read_numpy(path: Path) -> Floats:
    loaded: Any = np.load(path, allow_pickle=False)
    if path.suffix.lower() == ".npy":
        return np.asarray(loaded, np.float64)
    with loaded as arrays:
        name = next((one for one in _NAMES if one in arrays), None)
        if name is None:
            raise ValueError(f"no array named {' or '.join(_NAMES[:-1])}")
        return np.asarray(arrays[name], np.float64)


def _read_ply(path: Path) -> Floats:
    content = path.read_bytes()
    head, end, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not end:
        raise ValueError("no PLY header")
    body = body[body.find(b"\n") + 1 :]
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    form = next((line[1] for line in lines if line[:1] == ["format"]), "none")
    count, fields = _ply_vertices(lines)
    names = [name for name, _ in fields]
    _check_names(names)
    if form == "ascii":
        return _columns(body, count, len(fields))[:, [names.index(axis) for axis in "xyz"]]
    if form not in _PLY_ORDERS:
        raise ValueError(f"format '{form}' is none of PLY's")
    dtype = np.dtype([(name, _PLY_ORDERS[form] + kind) for name, kind in fields])
    return _fields(body, dtype, count)


def _ply_vertices(lines: list[list[str]]) -> tuple[int, list[tuple[str, str]]]:
    """How many vertices, and their properties with types; vertices must come first."""
    first = next((k for k, line in enumerate(lines) if line[:1] == ["element"]), None)
    if first is None or lines[first][1:2] != ["vertex"] or len(lines[first]) != 3:
        raise ValueError("its first element is not 'vertex'")
    fields = []
    for line in lines[first + 1 :]:
        if line[:1] == ["element"]:
            break
        if line[:1] == ["property"]:
            if len(line) != 3 or line[1] not in _PLY_TYPES:
                raise ValueError(f"property {' '.join(line[1:])} of a vertex is not supported")
            fields.append((line[2], _PLY_TYPES[line[1]]))
    return _count(lines[first][2]), fields


def _read_pcd(path: Path) -> Floats:
    content = path.read_bytes()
    found = re.search(rb"^DATA\s+(\S+)[^\n]*\n", content, re.MULTILINE)
    if found is None:
        raise ValueError("no PCD header")
    lines = content[: found.start()].decode("ascii", "replace").splitlines()
    head = {line.split()[0]: line.split()[1:] for line in lines if line.split()}
    names, sizes, kinds = head["FIELDS"], head["SIZE"], head["TYPE"]
    repeats = head.get("COUNT", ["1"] * len(names))
    _check_names(names)
    width, height = _count(head["WIDTH"][0]), _count(head["HEIGHT"][0])
    count, body, form = width * height, content[found.end() :], found[1].decode()
    _count(str(count))
    if form == "ascii":
        starts = np.cumsum([0, *map(int, repeats)])
        table = _columns(body, count, int(starts[-1]))
        points = table[:, [starts[names.index(axis)] for axis in "xyz"]]
    elif form == "binary":
        fields = zip(names, kinds, sizes, repeats, strict=True)
        types = [(n, f"<{k.lower()}{s}", (int(r),)) for n, k, s, r in fields]
        # a name that repeats, as PCL's padding '_' does, is no field
        unique = [(f"{n}{k}" if n not in "xyz" else n, t, r) for k, (n, t, r) in enumerate(types)]
        points = _fields(body, np.dtype(unique), count)
    else:
        raise ValueError(f"DATA {form} is not supported: save it as binary or ascii")
    return points.reshape(height, width, 3) if height > 1 else points


def _check_names(names: list[str]) -> None:
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise ValueError(f"points have no {' and '.join(missing)}")


def _count(text: str) -> int:
    count = int(text)
    if not 0 <= count <= MOST_POINTS:
        raise ValueError(f"it claims {text} points")
    return count


def _columns(body: bytes, count: int, columns: int) -> Floats:
    table = np.loadtxt(io.BytesIO(body), np.float64, max_rows=count or 1, ndmin=2)
    if table.shape != (count, columns) and count:
        raise ValueError(f"it is cut off: {len(table)} of {count} points")
    return table.reshape(-1, columns) if count else np.zeros((0, columns))


def _fields(body: bytes, dtype: np.dtype[Any], count: int) -> Floats:
    if len(body) < count * dtype.itemsize:
        raise ValueError(f"it is cut off: {len(body) // max(dtype.itemsize, 1)} of {count} points")
    rows = np.frombuffer(body, dtype, count)
    return np.column_stack([rows[axis].reshape(count) for axis in "xyz"]).astype(np.float64)
