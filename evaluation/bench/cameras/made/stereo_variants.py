"""Stereo folders as people have them: other units, sizes, lenses, names, lost images."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.cameras.made.scene import (
    FISHEYE_D,
    FISHEYE_K,
    RIG,
    Shot,
    content,
    half,
    save,
    seen,
    seen_through_fisheye,
)
from fleetpose.evaluation.bench.cameras.made.variants import Variant

Depth = npt.NDArray[np.float32]
_SIZE: dict[str, Any] = {"width": RIG.size[0], "height": RIG.size[1]}


def _pairs(folder: Path, shot: Shot, names: tuple[str, str] = ("0000.png", "0000.png")) -> None:
    save(folder / "left" / names[0], shot.left)
    save(folder / "right" / names[1], shot.right)


def _said(folder: Path, said: dict, name: str = "stereo.json") -> None:
    (folder / name).write_text(json.dumps(said))


def _scaled(folder: Path, unit_m: float) -> Depth:
    """The translation in a unit."""
    shot = seen()
    _pairs(folder, shot)
    _said(folder, content(**_SIZE) | {"T": (RIG.T_right_left[:3, 3] / unit_m).tolist()})
    return shot.depth


def _half_size(folder: Path, stated: bool) -> Depth:
    """Images of half the size that the calibration was made at."""
    shot = seen()
    save(folder / "left/0.png", half(shot.left))
    save(folder / "right/0.png", half(shot.right))
    _said(folder, content(**(_SIZE if stated else {})))
    return shot.depth


def _double_size(folder: Path) -> Depth:
    """Images of two times the size that the calibration was made at, which it does not say."""
    shot = seen()
    for side in ("left", "right"):
        save(folder / side / "0.png", cv2.resize(getattr(shot, side), None, fx=2, fy=2))
    _said(folder, content())
    return shot.depth


def _fisheye(folder: Path, wide: bool, column: bool) -> Depth:
    """`cv2.fisheye` under OpenCV's names."""
    K = np.array([[420.0, 0, 319.5], [0, 420.0, 239.5], [0, 0, 1]])
    D = np.array([0.01, -0.004, 0.002, -0.001])
    K, D = (FISHEYE_K, FISHEYE_D) if wide else (K, D)
    shot = seen_through_fisheye(K, D)
    _pairs(folder, shot)
    said = D.reshape(-1, 1).tolist() if column else D.tolist()
    matrices = {"K1": K.tolist(), "K2": K.tolist(), "D1": said, "D2": said}
    _said(folder, content(**_SIZE) | matrices)
    return shot.depth


def _swapped(folder: Path) -> Depth:
    shot = seen()
    save(folder / "left/0.png", shot.right)
    save(folder / "right/0.png", shot.left)
    _said(folder, content(**_SIZE))
    return shot.depth


def _inverted(folder: Path) -> Depth:
    """R and T the other way round."""
    shot = seen()
    _pairs(folder, shot)
    _said(folder, content(**_SIZE) | {"T": (-RIG.T_right_left[:3, 3]).tolist()})
    return shot.depth


def _negative(folder: Path, at: int) -> Depth:
    """A focal length below 0."""
    shot = seen()
    _pairs(folder, shot)
    K = RIG.K_left.copy()
    K[at, at] *= -1
    _said(folder, content(**_SIZE) | {"K1": K.tolist(), "K2": K.tolist()})
    return shot.depth


def _deep(folder: Path, bits: int) -> Depth:
    """Images of so many bits in 16."""
    shot = seen()
    for side in ("left", "right"):
        save(folder / side / "0.png", getattr(shot, side).astype(np.uint16) << (bits - 8))
    _said(folder, content(**_SIZE))
    return shot.depth


def _marked(folder: Path, encoding: str) -> Depth:
    """A calibration as an editor of another system keeps it."""
    shot = seen()
    _pairs(folder, shot)
    text = json.dumps(content(**_SIZE), indent=1).replace("\n", "\r\n")
    (folder / "stereo.json").write_bytes(text.encode(encoding))
    return shot.depth


def _rotated(folder: Path) -> Depth:
    """A vertical rig: the second eye below the first."""
    shot = seen()
    for side in ("left", "right"):
        turned = cv2.rotate(getattr(shot, side), cv2.ROTATE_90_CLOCKWISE)
        save(folder / side / "0.png", turned)
    f, cx, cy = RIG.K_left[0, 0], RIG.K_left[0, 2], RIG.K_left[1, 2]
    K = [[f, 0, 479 - cy], [0, f, cx], [0, 0, 1]]
    said = content(width=480, height=640) | {"K1": K, "K2": K, "T": [0.0, -0.5, 0.0]}
    _said(folder, said)
    return shot.depth  # its frames are turned back


_UNITS = (("mm", 0.001), ("cm", 0.01), ("squares_of_15_cm", 0.15), ("squares_of_3_cm", 0.03))
VARIANTS: tuple[Variant, ...] = (
    *(
        Variant(f"t_in_{name}", "stereo", partial(_scaled, unit_m=unit), "translation-unit")
        for name, unit in _UNITS
    ),
    *(
        Variant(
            f"t_in_{name}_told",
            "stereo",
            partial(_scaled, unit_m=unit),
            options={"translation_unit": unit},
        )
        for name, unit in _UNITS
    ),
    Variant("half_size_stated", "stereo", partial(_half_size, stated=True), "320x240.*640x480"),
    Variant("half_size_not_stated", "stereo", partial(_half_size, stated=False), "320x240"),
    Variant("double_size_not_stated", "stereo", _double_size, "1280x960"),
    Variant("fisheye_wide", "stereo", partial(_fisheye, wide=True, column=True), None),
    Variant(
        "fisheye_narrow", "stereo", partial(_fisheye, wide=False, column=True), "distortion_model"
    ),
    Variant("eyes_swapped", "stereo", _swapped, "change places"),
    Variant("t_inverted", "stereo", _inverted, "swap|change places"),
    Variant("fx_negative", "stereo", partial(_negative, at=0), "below 0"),
    Variant("fy_negative", "stereo", partial(_negative, at=1), "below 0"),
    *(Variant(f"{bits}_bits_in_16", "stereo", partial(_deep, bits=bits)) for bits in (10, 12, 14)),
    *(
        Variant(f"json_in_{encoding}", "stereo", partial(_marked, encoding=encoding))
        for encoding in ("utf-8-sig", "utf-16")
    ),
    Variant("vertical", "stereo", _rotated),
)
