"""Kinds of cameras, apart from the libraries that read them: settings need the names alone."""

from typing import Literal

CameraKind = Literal["rgbd", "views", "reconstruction", "bundler", "cloud", "stereo", "synthetic"]
