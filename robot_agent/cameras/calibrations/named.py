"""Matrices under names that nobody agreed on: ours, those of OpenCV's samples, and their like."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import (
    Floats,
    Lens,
    LensModel,
    StereoPair,
    flat,
    lens_model,
    rigid,
)

_K = r"k|m|mtx|matrix|cm|(?:camera|cam)mat(?:rix)?|intrinsics?(?:matrix)?"
_D = r"d|dist|distortions?|dist(?:ortion)?(?:coeff?s?|coefficients?)"
_SIDE = r"left|right|l|r|0|1|2"
_ONE_EYE = re.compile(
    rf"(?:cam(?:era)?)?(?P<before>{_SIDE})(?:cam(?:era)?)?(?P<k1>(?P<K1>{_K})|{_D})"
    rf"|(?P<k2>(?P<K2>{_K})|{_D})(?:cam(?:era)?)?(?P<after>{_SIDE})"
)
_ROTATION = ("r", "rot", "rotation", "rotationmatrix", "rmat", "rstereo", "stereor", "rlr")
_TRANSLATION = (
    *(
        "t",
        "trans",
        "translation",
        "translationvector",
        "tvec",
        "tvector",
        "tstereo",
        "stereot",
        "tlr",
    ),
    *("trightleft", "extrinsics", "extrinsic"),
)
_SIZE = ("imagesize", "imgsize", "size", "resolution", "imageresolution")
_SHAPE = ("shape", "imageshape", "imgshape")
_WIDTH, _HEIGHT = ("width", "imagewidth", "imgwidth"), ("height", "imageheight", "imgheight")
_MODEL = ("distortionmodel", "lensmodel", "lens", "cameramodel", "model")
_TANGENTIAL = 0.005  # p1, p2 of a normal lens: production lenses are centred better than this
_BARREL = -0.1  # k1 of normal lenses; a fisheye's model has the barrel in it, and k1 is near 0
_WIDE_RAD = np.radians(90.0)  # as far as the normal model is used for


def recognises(content: Mapping[str, Any]) -> bool:
    """Whether any name is that of a matrix of one eye."""
    return any(_eye_of(name) for name, _ in _names(content))


def read(content: Mapping[str, Any], where: str) -> StereoPair:
    """The rig that matrices under such names make.

    Raises:
        CalibrationError: something is missing.
    """
    values = {_plain(name): value for name, value in _names(content)}
    eyes = _eyes(content)
    R, T = _first(values, _ROTATION), _first(values, _TRANSLATION)
    if T is not None and flat(T, "T", where).size == 16:
        T_right_left = flat(T, "T", where).reshape(4, 4)
    else:
        found = {"K_left": eyes.get("K0"), "K_right": eyes.get("K1"), "R": R, "t": T}
        if missing := [name for name, value in found.items() if value is None]:
            raise CalibrationError(f"{where} lacks {', '.join(missing)}")
        T_right_left = rigid(_rotation(R, where), _sized(T, "T", where, 3))
    if missing := [name for name, key in (("K_left", "K0"), ("K_right", "K1")) if key not in eyes]:
        raise CalibrationError(f"{where} lacks {', '.join(missing)}")
    size = _size_of(values, where)
    said = _first(values, _MODEL)
    lenses = [_lens(eyes, eye, said, size, where) for eye in (0, 1)]
    T_robot_left = None
    if "T_robot_left" in content:
        T_robot_left = _sized(content["T_robot_left"], "T_robot_left", where, 16).reshape(4, 4)
    return StereoPair(lenses[0], lenses[1], T_right_left, size, T_robot_left)


def _names(content: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """All names with what they hold; of what lies in a section of an eye, the section's before."""
    for name, value in content.items():
        if isinstance(value, Mapping) and "data" not in value:
            eye = re.fullmatch(
                r"(?:cam(?:era)?)?_?(left|right|l|r)(?:_?cam(?:era)?)?", str(name).lower()
            )
            yield from _names(value, f"{eye[1]}_" if eye else before)
        else:
            yield before + str(name), value


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _eye_of(name: str) -> tuple[str, str] | None:
    """K or D, and the side as the name has it."""
    found = _ONE_EYE.fullmatch(_plain(name))
    if found is None:
        return None
    return "K" if found["K1"] or found["K2"] else "D", found["before"] or found["after"]


def _eyes(content: Mapping[str, Any]) -> dict[str, Any]:
    """K0, D0 of the left eye and K1, D1 of the right one; whether numbers begin at 0 or at 1 is
    told by which there are.
    """
    named = [(eye, value) for name, value in _names(content) if (eye := _eye_of(name))]
    from_zero = any(side == "0" for (_, side), _ in named)
    numbers = {"0": 0, "1": 1} if from_zero else {"1": 0, "2": 1}
    sides = {"left": 0, "l": 0, "right": 1, "r": 1, **numbers}
    return {f"{kind}{sides[side]}": value for (kind, side), value in named if side in sides}


def _lens(
    eyes: Mapping[str, Any], eye: int, said: Any, size: tuple[int, int] | None, where: str
) -> Lens:
    name = ("left", "right")[eye]
    K = _sized(eyes[f"K{eye}"], f"K_{name}", where, 9).reshape(3, 3)
    given = eyes.get(f"D{eye}")
    D = np.zeros(5) if given is None else flat(given, f"D_{name}", where)
    return Lens(K, D, lens_model(said, where) if said is not None else _guess(K, D, size, where))


def _guess(K: Floats, D: Floats, size: tuple[int, int] | None, where: str) -> LensModel:
    """Four numbers may be k1 k2 p1 p2, or those of `cv2.fisheye`, which has the same names; what
    only a fisheye has tells them apart.
    """
    if D.size != 4 or not D.any():
        return "normal"
    width = 2 * K[0, 2] if size is None else size[0]
    wide = 2 * np.arctan(width / (2 * K[0, 0])) > _WIDE_RAD
    off_centre = np.abs(D[2:]).max() > _TANGENTIAL
    if wide and off_centre:
        return "fisheye"
    if D[0] < _BARREL and not off_centre:
        return "normal"
    raise CalibrationError(
        f"{where} has 4 numbers of distortion and does not say what they are: write "
        '"distortion_model": "radtan" (k1 k2 p1 p2) or "equidistant" (cv2.fisheye) into it'
    )


def _size_of(values: Mapping[str, Any], where: str) -> tuple[int, int] | None:
    width, height = _first(values, _WIDTH), _first(values, _HEIGHT)
    if width is not None and height is not None:
        w, h = (_sized(value, "the size of the images", where, 1)[0] for value in (width, height))
        return int(w), int(h)
    for names, order in ((_SIZE, (0, 1)), (_SHAPE, (1, 0))):
        if (found := _first(values, names)) is not None:
            pair = flat(found, "the size of the images", where)
            if pair.size >= 2:
                return int(pair[order[0]]), int(pair[order[1]])
    return None


def _first(values: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((values[name] for name in names if name in values), None)


def _sized(value: Any, name: str, where: str, count: int) -> Floats:
    found = flat(value, name, where)
    if found.size != count:
        raise CalibrationError(f"{where}: {name} needs {count} numbers, it has {found.size}")
    return found


def _rotation(value: Any, where: str) -> Floats:
    """A rotation given as a matrix or as a rotation vector."""
    R = flat(value, "R", where)
    if R.size == 3:
        return np.asarray(cv2.Rodrigues(R.reshape(3, 1))[0], np.float64)
    return _sized(value, "R", where, 9)
