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

from fleetpose.formats.ply import MOST_POINTS, read_ply
from fleetpose.protocol.errors import DataFolderError

Floats = npt.NDArray[np.float64]

ENDINGS = (".ply", ".pcd", ".npz", ".npy")
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
    vertices = read_ply(path).vertices
    _check_names(list(vertices.dtype.names or ()))
    return np.column_stack([vertices[axis] for axis in "xyz"]).astype(np.float64)


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
