"""COLMAP's text files: one record a line, of an image two; lines with # are remarks.

Raises:
    FormatError: a file is missing, cut off, or holds no numbers where they should be.
    ValueError: lines have too few of them.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError
from fleetpose.formats.reconstructions.colmap_records import (
    ColmapCamera,
    ColmapImage,
    ColmapPoints,
    Track,
    check_model,
)
from fleetpose.formats.text import joined, lines_of, numbers_of, shortest

_COUNT = re.compile(r"# Number of \w+: (\d{1,18})\b")  # a remark that COLMAP itself writes


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Cameras by their ids: id, model, width, height, parameters."""
    cameras = {}
    for number, model, *rest in (line.split() for line in _lines(path) if line):
        check_model(path, model)
        width, height, *parameters = numbers_of(path, " ".join(rest))
        cameras[int(number)] = ColmapCamera(
            model, (int(width), int(height)), np.array(parameters, np.float64)
        )
    return cameras


def read_images(path: Path) -> list[ColmapImage]:
    """Images: id, rotation, translation, camera, name; below, keypoints as x, y, point."""
    images = []
    lines = iter(_lines(path, lines_each=2))
    for line in lines:
        if line:
            *words, camera, name = line.split(maxsplit=9)  # names may have blanks
            pose = numbers_of(path, " ".join(words[1:])).reshape(7)
            keypoints = numbers_of(path, next(lines, "")).reshape(-1, 3)
            points = keypoints[:, 2].astype(np.int64)
            images.append(ColmapImage(name, int(camera), pose, keypoints[:, :2], points))
    return images


def read_points(path: Path) -> ColmapPoints:
    """Points: id, x, y, z, r, g, b, and what is not needed."""
    rows = [line.split(maxsplit=7)[:7] for line in _lines(path) if line]
    numbers = numbers_of(path, " ".join(" ".join(row) for row in rows)).reshape(-1, 7)
    return ColmapPoints(numbers[:, 0].astype(np.int64), numbers[:, 1:4], numbers[:, 4:])


def write_cameras(path: Path, cameras: Mapping[int, ColmapCamera]) -> None:
    """Writes cameras by their ids."""
    _write(
        path,
        "cameras",
        len(cameras),
        (
            f"{number} {camera.model} {camera.size[0]} {camera.size[1]} {joined(camera.parameters)}"
            for number, camera in cameras.items()
        ),
    )


def write_images(path: Path, images: Sequence[ColmapImage]) -> None:
    """Writes images, numbered from 1 in their order."""
    lines = []
    for number, image in enumerate(images, 1):
        lines.append(f"{number} {joined(image.pose)} {image.camera} {image.name}")
        seen = zip(image.at, image.points.tolist(), strict=True)
        lines.append(" ".join(f"{joined(uv)} {point}" for uv, point in seen))
    _write(path, "images", len(images), lines)


def write_points(
    path: Path, points: ColmapPoints, errors_px: Floats, tracks: Sequence[Track]
) -> None:
    """Writes points with their reprojection errors and the images and keypoints that saw each."""
    rows = zip(points.ids.tolist(), points.xyz, points.colours, errors_px, tracks, strict=True)
    lines = (
        f"{number} {joined(xyz)} {' '.join(str(int(c)) for c in colour)} {shortest(error)} "
        + " ".join(f"{image} {keypoint}" for image, keypoint in track)
        for number, xyz, colour, error, track in rows
    )
    _write(path, "points", len(points.ids), lines)


def _write(path: Path, what: str, count: int, lines: Iterable[str]) -> None:
    head = f"# Number of {what}: {count}\n"
    path.write_text(head + "".join(f"{line}\n" for line in lines), encoding="utf-8")


def _lines(path: Path, lines_each: int = 1) -> list[str]:
    """All lines but the remarks, which must be as many as a remark says, if one does."""
    lines = lines_of(path)
    found = [line for line in lines if not line.startswith("#")]
    for said in (int(match[1]) for line in lines if (match := _COUNT.match(line))):
        if said * lines_each > len(found):
            raise FormatError(f"{path} is cut off: it says that it holds {said} records")
    return found
