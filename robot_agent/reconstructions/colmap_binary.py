"""COLMAP's binary files: little-endian, a count of records, then the records.

Raises:
    DataFolderError: a file is missing or cut off.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.colmap_records import (
    CAMERA_MODELS,
    ColmapCamera,
    ColmapImage,
    ColmapPoints,
    check_model,
)

_MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
)
_KEYPOINT = np.dtype([("at", "<f8", 2), ("point", "<i8")])
_TRACK = np.dtype([("image", "<i4"), ("keypoint", "<i4")])


class _Bytes:
    """A file that is read from its start to its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._at = 0
        try:
            self._bytes = path.read_bytes()
        except OSError as error:
            raise DataFolderError(f"{path} cannot be read: {error}") from error

    def numbers(self, form: str) -> tuple[Any, ...]:
        """The next numbers, as `struct` calls them."""
        return struct.unpack(f"<{form}", self._next(struct.calcsize(f"<{form}")))

    def array(self, dtype: npt.DTypeLike, count: int) -> npt.NDArray[Any]:
        """(count,) of a type."""
        return np.frombuffer(self._next(np.dtype(dtype).itemsize * count), dtype)

    def text(self) -> str:
        """Up to a byte of 0."""
        end = self._bytes.find(b"\0", self._at)
        if end < 0:
            raise self._cut_off()
        return self._next(end + 1 - self._at)[:-1].decode(errors="replace")

    def _next(self, size: int) -> bytes:
        start, self._at = self._at, self._at + size
        if self._at > len(self._bytes):
            raise self._cut_off()
        return self._bytes[start : self._at]

    def _cut_off(self) -> DataFolderError:
        return DataFolderError(f"{self.path} is cut off: it has {len(self._bytes)} bytes")


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Cameras by their ids."""
    file = _Bytes(path)
    cameras = {}
    for _ in range(*file.numbers("Q")):
        number, model, *size = file.numbers("iiQQ")
        name = _MODELS[model] if 0 <= model < len(_MODELS) else f"number {model}"
        check_model(path, name)
        parameters = file.array("<f8", 2 + sum(CAMERA_MODELS[name]))
        cameras[number] = ColmapCamera(name, (size[0], size[1]), parameters)
    return cameras


def read_images(path: Path) -> list[ColmapImage]:
    """Images with their keypoints."""
    file = _Bytes(path)
    images = []
    for _ in range(*file.numbers("Q")):
        file.numbers("i")  # its id, which only tracks use
        pose = file.array("<f8", 7)
        (camera,), name = file.numbers("i"), file.text()
        keypoints = file.array(_KEYPOINT, *file.numbers("Q"))
        images.append(ColmapImage(name, camera, pose, keypoints["at"], keypoints["point"]))
    return images


def read_points(path: Path) -> ColmapPoints:
    """Points; their tracks say what the images say."""
    file = _Bytes(path)
    rows = []
    for _ in range(*file.numbers("Q")):
        *row, _error, views = file.numbers("q3d3BdQ")
        file.array(_TRACK, views)
        rows.append(row)
    numbers = np.array([row[1:] for row in rows], np.float64).reshape(-1, 6)
    ids = np.array([row[0] for row in rows], np.int64)
    return ColmapPoints(ids, numbers[:, :3], numbers[:, 3:])
