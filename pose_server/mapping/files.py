"""A map as files: the cloud, and a picture of it."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fleetpose.pose_server.mapping.ply import write_map
from fleetpose.pose_server.mapping.scene import Scene
from fleetpose.protocol.errors import FleetPoseError

PICTURES = (".png", ".pdf", ".svg", ".jpg")
LEAST_VOXEL_M = 1e-3
"""Depths are sent in millimetres: nothing smaller is told apart."""


class MapFileError(FleetPoseError):
    """A map cannot be written as it was asked for."""


@dataclass(frozen=True)
class MapFiles:
    """What is wanted of a map.

    Attributes:
        cloud: the PLY file.
        picture: its format is what the ending says.
        voxel_m: edge of its voxels, metres; what suits the cameras if not told.
    """

    cloud: Path | None = None
    picture: Path | None = None
    voxel_m: float | None = None

    @property
    def wanted(self) -> bool:
        """Whether anything is."""
        return self.cloud is not None or self.picture is not None

    def check(self) -> None:
        """Says what cannot be, before anybody waits for it.

        Raises:
            MapFileError: this cannot.
        """
        if self.cloud is not None and self.cloud.suffix != ".ply":
            raise MapFileError(f"--map {self.cloud}: the map is a PLY file, call it NAME.ply")
        if self.picture is not None and self.picture.suffix not in PICTURES:
            raise MapFileError(f"--picture {self.picture}: must end in {', '.join(PICTURES)}")
        if self.voxel_m is not None and not self.wanted:
            raise MapFileError("--voxel-m goes with --map or --picture")
        if self.voxel_m is not None and not LEAST_VOXEL_M <= self.voxel_m < math.inf:
            raise MapFileError(f"--voxel-m {self.voxel_m:g}: give {LEAST_VOXEL_M:g} m or more")

    def write(self, scene: Scene) -> None:
        """Writes the files, and makes their folders.

        Raises:
            MapFileError: one cannot be written.
        """
        if self.cloud is not None:
            with _told("--map", self.cloud):
                self.cloud.parent.mkdir(parents=True, exist_ok=True)
                write_map(self.cloud, scene.fleet_map)
        if self.picture is not None:
            from fleetpose.pose_server.mapping.picture import draw  # matplotlib takes a while

            with _told("--picture", self.picture):
                self.picture.parent.mkdir(parents=True, exist_ok=True)
                draw(scene, self.picture)


@contextmanager
def _told(option: str, path: Path) -> Iterator[None]:
    """Which option's file cannot be written, and why."""
    try:
        yield
    except OSError as error:
        raise MapFileError(f"{option} {path}: {error.strerror or error}") from error
