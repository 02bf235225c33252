"""COLMAP's binary files: little-endian, a count of records, then the records.

Raises:
    FormatError: a file is missing or cut off.
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.formats.arrays import Floats, FormatError
from fleetpose.formats.reconstructions.colmap_records import (
    CAMERA_MODELS,
    ColmapCamera,
    ColmapImage,
    ColmapPoints,
    Track,
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
            raise FormatError(f"{path} cannot be read: {error}") from error

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

    def _cut_off(self) -> FormatError:
        return FormatError(f"{self.path} is cut off: it has {len(self._bytes)} bytes")


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


def write_cameras(path: Path, cameras: Mapping[int, ColmapCamera]) -> None:
    """Writes cameras by their ids."""
    parts = [struct.pack("<Q", len(cameras))]
    for number, camera in cameras.items():
        parts.append(struct.pack("<iiQQ", number, _MODELS.index(camera.model), *camera.size))
        parts.append(np.ascontiguousarray(camera.parameters, "<f8").tobytes())
    path.write_bytes(b"".join(parts))


def write_images(path: Path, images: Sequence[ColmapImage]) -> None:
    """Writes images, numbered from 1 in their order."""
    parts = [struct.pack("<Q", len(images))]
    for number, image in enumerate(images, 1):
        keypoints = np.empty(len(image.points), _KEYPOINT)
        keypoints["at"], keypoints["point"] = image.at, image.points
        parts += [
            struct.pack("<i7di", number, *image.pose, image.camera),
            image.name.encode() + b"\0",
            struct.pack("<Q", len(keypoints)),
            keypoints.tobytes(),
        ]
    path.write_bytes(b"".join(parts))


def write_points(
    path: Path, points: ColmapPoints, errors_px: Floats, tracks: Sequence[Track]
) -> None:
    """Writes points with their reprojection errors and the images and keypoints that saw each."""
    parts = [struct.pack("<Q", len(points.ids))]
    rows = zip(points.ids.tolist(), points.xyz, points.colours, errors_px, tracks, strict=True)
    for number, xyz, colour, error, track in rows:
        colours = (int(c) for c in colour)
        parts.append(struct.pack("<q3d3BdQ", number, *xyz, *colours, error, len(track)))
        parts.append(np.array(list(track), _TRACK).tobytes())
    path.write_bytes(b"".join(parts))
