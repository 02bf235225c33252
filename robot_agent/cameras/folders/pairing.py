"""Which recorded images of two eyes belong together: by their names, else by stamps in these."""

import logging
import re
from collections.abc import Sequence
from pathlib import Path

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import OtherKindError

log = logging.getLogger(__name__)

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")
MAX_SKEW_MS = 10.0
_LAYOUTS = (
    ("left", "right"),
    ("mav0/cam0/data", "mav0/cam1/data"),  # EuRoC
    ("cam0/data", "cam1/data"),
    ("cam0", "cam1"),
    ("image_0", "image_1"),  # KITTI: grey, then colour
    ("image_2", "image_3"),
    ("image_00/data", "image_01/data"),
    ("image_02/data", "image_03/data"),
    ("image_left", "image_right"),  # TartanAir
    ("rgb", "rgb2"),  # ETH3D
    ("infra1", "infra2"),
    ("Left", "Right"),
    ("images/left", "images/right"),
    ("data/left", "data/right"),
)
_KIND = re.compile(
    r"left|right|colou?r|rgb|depth|image|(?:^|(?<=[^a-z]))[lr](?=[^a-z]|$)|cam(?:era)?[01]|infra[12]|ir[12]",
    re.IGNORECASE,
)
_STAMP_DIGITS = 13  # of the ms since 1970; ns have 19


def eyes_of(folder: Path) -> tuple[Path, Path]:
    """The folders of the left and the right images, in any layout that is known.

    Raises:
        OtherKindError: there are none.
    """
    for left, right in _LAYOUTS:
        if (folder / left).is_dir() and (folder / right).is_dir():
            return folder / left, folder / right
    known = ", ".join(f"{left} with {right}" for left, right in _LAYOUTS)
    raise OtherKindError(f"{folder} has no images of two eyes: put them into {known}")


def list_images(folder: Path) -> list[Path]:
    """The images of a folder in natural order: 2 before 10.

    Raises:
        DataFolderError: there are none.
    """
    images = [path for path in folder.glob("*") if path.suffix.lower() in ENDINGS]
    if not images:
        raise DataFolderError(f"{folder} has no images ({', '.join(ENDINGS)})")
    return sorted(images, key=lambda path: _natural(path.stem))


def paired(
    left: Sequence[Path],
    right: Sequence[Path],
    max_skew_ms: float = MAX_SKEW_MS,
    words: tuple[str, str, str] = ("left and right", "left", "right"),
) -> list[tuple[Path, Path]]:
    """The images of both eyes, or of colour and depth, that have the same name but for what says
    which of the two it is, or stamps that are near enough; those without a partner are left out,
    and told by these words.

    Raises:
        DataFolderError: none belong together; the sentence names the first without a partner.
    """
    by_name = {_without_kind(path): path for path in right}
    pairs = [(path, by_name[name]) for path in left if (name := _without_kind(path)) in by_name]
    if not pairs:
        pairs = _by_stamp(left, right, max_skew_ms)
    if not pairs:
        raise DataFolderError(
            f"{left[0]} has no partner in {right[0].parent}, whose first is {right[0].name}: "
            f"images that belong together need equal names (but for {words[0]}), or stamps in "
            f"nanoseconds within {max_skew_ms:g} ms (--max-skew-ms)"
        )
    for side, images, k in ((words[1], left, 0), (words[2], right, 1)):
        taken = {pair[k] for pair in pairs}
        if alone := [path for path in images if path not in taken]:
            log.warning(
                "%d of %d %s images have no partner and are left out, the first is %s",
                *(len(alone), len(images), side, alone[0]),
            )
    return pairs


def _natural(text: str) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", text.lower())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts if part]


def _without_kind(path: Path) -> str:
    """Its name in lower case without what says which of the two it is, nor leading zeros."""
    name = _KIND.sub("", path.stem.lower())
    return re.sub(r"\d+", lambda found: str(int(found[0])), name)


def _by_stamp(
    left: Sequence[Path], right: Sequence[Path], max_skew_ms: float
) -> list[tuple[Path, Path]]:
    """Each left image with the nearest right one, each of which is taken once."""
    stamps_ns = {path: stamp for path in (*left, *right) if (stamp := _stamp_ns(path)) is not None}
    free = [path for path in right if path in stamps_ns]
    pairs = []
    for path in left:
        if path not in stamps_ns or not free:
            continue
        near = min(free, key=lambda other: abs(stamps_ns[other] - stamps_ns[path]))
        if abs(stamps_ns[near] - stamps_ns[path]) <= 1e6 * max_skew_ms:
            pairs.append((path, near))
            free.remove(near)
    return pairs


def _stamp_ns(path: Path) -> int | None:
    """The time in a name: s with a point, or ms, us or ns since 1970."""
    if re.fullmatch(r"\d{9,10}\.\d+", path.stem):
        return round(1e9 * float(path.stem))
    digits = _KIND.sub("", path.stem).strip("_-.")
    if not digits.isdigit() or len(digits) < _STAMP_DIGITS:
        return None
    return int(digits) * 10 ** (19 - len(digits)) if len(digits) <= 19 else None
