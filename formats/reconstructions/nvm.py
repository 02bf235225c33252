"""VisualSfM's result (Wu 2011): `NAME.nvm` of version 3, as its manual describes it.

Pixels count from the principal point, y down; cameras have OpenCV axes and tell their centre. The
distortion goes the other way round: a measurement m becomes (1 + d |m|^2 / f^2) m without it.
"""

import re
from math import comb
from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices
from fleetpose.formats.reconstructions.photos import MOST_NAMED, SQUARE_WITHIN, Model, Photo
from fleetpose.formats.reconstructions.tracks import point_lines, read_points
from fleetpose.formats.rotations import pose_of, quat_wxyz
from fleetpose.formats.text import joined, lines_of, numbers_of

_MAGIC, _FIXED = "NVM_V3", "FixedK"
_CAMERA_NUMBERS = 10  # focal length, rotation (w, x, y, z), centre, distortion, 0


def image_folders(nvm: Path) -> tuple[Path, ...]:
    """Where images may lie that a file does not tell a whole path of: beside it, or in `images`."""
    return nvm.parent, nvm.parent / "images"


def read_nvm(nvm: Path) -> Model:
    """Reads the first model of the file, which is the largest.

    Raises:
        FormatError: a file is missing, cut off, or says what cannot be; the text names it.
    """
    header, *lines = _lines(nvm)
    cameras, lines = _counted(nvm, lines, "cameras")
    rows, _ = _counted(nvm, lines, "points")
    numbers = numbers_of(nvm, " ".join(rows))
    points, colours, seen = read_points(nvm, numbers, len(rows), len(cameras))
    centre = _fixed_centre(nvm, header)
    photos = [_photo(nvm, *one, centre) for one in zip(cameras, seen, strict=True)]
    return Model(tuple(photos), points, colours)


def write_nvm(nvm: Path, model: Model) -> None:
    """Writes a model. Cameras that share focal length and principal point have them in the first
    line (`FixedK`); of others the format knows no principal point, and features count from it.

    Raises:
        FormatError: a camera has no place in this format; the text names it.
        OSError: it cannot be written.
    """
    lines = [_header(model), "", str(len(model.photos))]
    for photo in model.photos:
        T = photo.T_camera_world
        centre = -T[:3, :3].T @ T[:3, 3]
        numbers = np.array(
            [photo.square_focal_px, *quat_wxyz(T[:3, :3]), *centre, _visualsfms(photo), 0.0]
        )
        lines.append(f"{_without_blanks(photo.name)}\t{joined(numbers)}")
    lines += ["", str(len(model.points))]
    at = [photo.square_at for photo in model.photos]
    lines += [" ".join(words) for words in point_lines(model, at)]
    nvm.write_text("".join(f"{line}\n" for line in (*lines, "", "0")), encoding="utf-8")


def _header(model: Model) -> str:
    found = {
        (photo.square_focal_px, *photo.centre) for photo in model.photos if photo.centre is not None
    }
    if len(found) != 1 or any(photo.centre is None for photo in model.photos):
        return _MAGIC
    ((f, cx, cy),) = found
    return f"{_MAGIC} {_FIXED} {joined(np.array([f, cx, f, cy]))}"


def _without_blanks(name: str) -> str:
    if '"' in name or name != name.strip() or not name or set(name) & set("\t\r\n"):
        raise FormatError(f"image {name[:MOST_NAMED]!r}: give it a plain name")
    return name.replace(" ", '"')  # as VisualSfM does


def _visualsfms(photo: Photo) -> float:
    """d of a photo whose distortion is one that it can say."""
    d = float(photo.distortion[0] / opencvs(1.0)[0])
    if not np.allclose(np.pad(photo.distortion, (0, 8))[:8], opencvs(d), atol=1e-12):
        raise FormatError(
            f"{photo.name[:MOST_NAMED]} has distortion that VisualSfM does not know: undistort it"
        )
    return d


def _lines(nvm: Path) -> list[str]:
    lines = [line for line in lines_of(nvm) if line]
    if not lines or lines[0].split()[0] != _MAGIC:
        raise FormatError(f"{nvm} does not begin with '{_MAGIC}': save it as such")
    return lines


def _counted(nvm: Path, lines: list[str], what: str) -> tuple[list[str], list[str]]:
    """The lines that the first one counts, and the rest."""
    if not lines or not re.fullmatch(r"\d{1,18}", lines[0]):
        raise FormatError(f"{nvm} does not say how many {what} it holds")
    count = int(lines[0])
    if len(lines) <= count:
        raise FormatError(f"{nvm} is cut off: it says {count} {what}, has {len(lines) - 1}")
    return lines[1 : count + 1], lines[count + 1 :]


def _fixed_centre(nvm: Path, header: str) -> Floats | None:
    """The principal point that a header `NVM_V3 FixedK fx cx fy cy` gives all cameras."""
    words = header.split()
    if _FIXED not in words:
        return None
    numbers = numbers_of(nvm, " ".join(words[words.index(_FIXED) + 1 :]))
    if len(numbers) < 4:
        raise FormatError(f"{nvm}: write the first line as '{_MAGIC} {_FIXED} fx cx fy cy'")
    fx, cx, fy, cy = numbers[:4]
    if abs(fx - fy) > SQUARE_WITHIN * abs(fx):
        raise FormatError(
            f"{nvm}: pixels that are not square (fx {fx:g}, fy {fy:g}) are not supported: "
            "undistort the images before"
        )
    return np.array([cx, cy])


def _photo(nvm: Path, line: str, seen: tuple[Indices, Floats], centre: Floats | None) -> Photo:
    name, *words = line.rsplit(maxsplit=_CAMERA_NUMBERS)  # names may have blanks
    numbers = numbers_of(nvm, " ".join(words))
    if len(numbers) < _CAMERA_NUMBERS:
        raise FormatError(f"{nvm} is cut off in the camera of {name}")
    T = pose_of(numbers[1:5], np.zeros(3))
    T[:3, 3] = -T[:3, :3] @ numbers[5:8]
    name = name.replace('"', " ")  # which VisualSfM writes for blanks
    return Photo(name, numbers[[0, 0]], opencvs(numbers[8]), T, *seen, centre)


def opencvs(d: float) -> Floats:
    """(8,) OpenCV's vector k1, k2, p1, p2, k3 to k6 that undoes u = (1 + d r^2) r.

    Lagrange's inversion gives r / u as a series in d u^2; its Padé approximant [3/3] is OpenCV's
    rational model. At r = 1 it is off by 0.00001 for d = -0.1, and by less for d > 0.
    """
    series = np.array([(-1) ** n * comb(3 * n, n) / (2 * n + 1) for n in range(7)])
    below = np.ones(4)
    below[1:] = np.linalg.solve([series[[m - 1, m - 2, m - 3]] for m in (4, 5, 6)], -series[4:])
    above = np.convolve(series[:4], below)[:4]
    powers = d ** np.arange(1, 4)
    k1, k2, k3 = above[1:] * powers
    return np.array([k1, k2, 0.0, 0.0, k3, *(below[1:] * powers)])
