"""Kinds of cameras, apart from the libraries that read them: settings need the names alone."""

from typing import Literal

CameraKind = Literal[
    "rgbd", "views", "reconstruction", "bundler", "cloud", "stereo", "bag", "ros", "synthetic"
]


def clock_of(kind: CameraKind) -> Literal["live", "recorded"]:
    """Whose time a kind's stamps are of; recordings of images alone are stamped when shown."""
    return "recorded" if kind == "bag" else "live"
