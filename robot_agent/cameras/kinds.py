"""Kinds of cameras, apart from the libraries that read them: settings need the names alone."""

from typing import Literal

from fleetpose.protocol.messages.fields import Clock

CameraKind = Literal[
    "rgbd", "views", "reconstruction", "bundler", "cloud", "stereo", "bag", "synthetic"
]


def clock_of(kind: CameraKind) -> Clock:
    """Whose time a kind's stamps are of; recordings of images alone are stamped when shown."""
    return "recorded" if kind == "bag" else "live"
