"""Reading a recording's files, with errors that name the file."""

import codecs
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.protocol.messages import Camera, NoiseModel

NO_DEPTH = 65535
_AS_IT_LIES = cv2.IMREAD_IGNORE_ORIENTATION
"""EXIF would turn the colour image, and not its depth or its other eye."""


def read_colour(path: Path) -> npt.NDArray[np.uint8]:
    """A colour image (H, W, 3) uint8 BGR.

    Raises:
        DataFolderError: there is no such image.
    """
    image = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | _AS_IT_LIES)
    if image is None:
        raise DataFolderError(f"{path} is missing or no image")
    if image.dtype == np.uint16:
        image = _eight_bits(np.asarray(image, np.uint16))
    return np.asarray(image, np.uint8)


def _eight_bits(image: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint8]:
    """Of a sensor of 10, 12, 14 or 16 bits, which is written into the lower ones of 16."""
    bits = next(bits for bits in (8, 10, 12, 14, 16) if image.max() < 1 << bits)
    return (image >> (bits - 8)).astype(np.uint8)


def read_depth(path: Path, steps_per_m: float, furthest_m: float) -> npt.NDArray[np.float32]:
    """A 16-bit depth image (H, W) as metres, nan where it is 0 or beyond the furthest.

    Raises:
        DataFolderError: there is no such image.
    """
    raw = read_raw_depth(path)
    depth = raw.astype(np.float32)
    depth /= np.float32(steps_per_m)
    depth[(raw == 0) | (raw == NO_DEPTH) | (depth > furthest_m)] = np.nan
    return depth


def read_raw_depth(path: Path) -> npt.NDArray[np.uint16]:
    """A 16-bit depth image (H, W) as it is written, 0 or 65535 where there is none.

    Raises:
        DataFolderError: there is no such image.
    """
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.dtype != np.uint16 or raw.ndim != 2:
        raise DataFolderError(f"{path} is missing or no 16-bit depth image")
    return np.asarray(raw, np.uint16)


def text_of(path: Path) -> str:
    """The text of a file in UTF-8 or, as Windows' shell writes it, UTF-16, with or without a byte
    order mark.

    Raises:
        OSError: it cannot be read.
        ValueError: it is in neither.
    """
    content = path.read_bytes()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    return content.decode("utf-8-sig")


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises:
        DataFolderError: it is missing or no JSON.
    """
    try:
        return json.loads(text_of(path))
    except (OSError, ValueError, RecursionError) as error:
        raise DataFolderError(f"{path} cannot be read as JSON: {error}") from error


def read_numbers(path: Path) -> npt.NDArray[np.float64]:
    """The numbers of a text file, a row a line: between spaces, commas or semicolons, with or
    without a byte order mark, and lines that begin with # left out.

    Raises:
        CalibrationError: a line holds something else, or not as many numbers as the first.
    """
    try:
        lines = text_of(path).splitlines()
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path} cannot be read: {error}") from error
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError as error:
            raise CalibrationError(
                f"{path}, line {number}: '{line.strip()[:40]}' is no row of numbers"
            ) from error
        if len(rows[-1]) != len(rows[0]):
            raise CalibrationError(
                f"{path}, line {number} has {len(rows[-1])} numbers, the first {len(rows[0])}"
            )
    return np.array(rows, np.float64)


def model_of(where: str, **fields: Any) -> Camera:
    """A camera's model as it goes on the wire.

    Args:
        where: what its calibration was read from.
        fields: of `protocol.messages.Camera`.

    Raises:
        CalibrationError: no such camera can be; the sentence says what to fix.
    """
    try:
        return Camera(**fields)
    except ValidationError as error:
        said = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise CalibrationError(
            f"{where}: {said}; K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels of the "
            f"{fields.get('width')}x{fields.get('height')} image"
        ) from error


def noise_of(content: Any, path: Path) -> NoiseModel:
    """A noise model as a recording states it.

    Raises:
        CalibrationError: it is none; the sentence names the field.
    """
    try:
        return NoiseModel.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise CalibrationError(f"{path}: noise.{place}: {first['msg']}") from error
