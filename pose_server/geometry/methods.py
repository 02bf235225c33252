"""Names of methods, apart from the libraries that do the work: settings need the names alone."""

from typing import Literal

IcpMethod = Literal["gicp", "point_to_point", "point_to_plane", "off"]
"""`gicp` takes plain points one by one, where clouds are too sparse to have surfaces."""
