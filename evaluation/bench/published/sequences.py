"""A recorded sequence with its truth, and the folders that its robots get: links to some of its
images, and no truth.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.cameras.kinds import CameraKind


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame of a sequence.

    Attributes:
        files: its images, below the sequence's folder.
        stamp_ns: as the data set has it.
        T_world_camera: (4, 4) the truth; none where the data set tells none.
    """

    files: tuple[Path, ...]
    stamp_ns: int
    T_world_camera: Floats | None = None


@dataclass(frozen=True, eq=False)
class RecordedSequence:
    """What one robot saw.

    Attributes:
        name: of the robot.
        folder: of the sequence.
        camera: the kind of camera that reads it.
        linked: files that the camera needs beside the images, by where they are to lie.
        written: the same, of texts that the data set comes without.
        lists: files that list the images of each frame, in the order of its files: TUM's.
    """

    name: str
    folder: Path
    camera: CameraKind
    shots: tuple[Shot, ...]
    linked: Mapping[str, Path] = field(default_factory=dict)
    written: Mapping[str, str] = field(default_factory=dict)
    lists: tuple[str, ...] = ()

    def every(self, step: int, most: int | None = None) -> "RecordedSequence":
        """Each so-manieth frame, the first ones."""
        return self._with(self.name, self.shots[::step][:most])

    def split(self, parts: int, in_turn: bool = True) -> list["RecordedSequence"]:
        """As many robots: each a part of the way, one after the other, or all of it with every
        so-manieth frame.

        Raises:
            DataFolderError: there are fewer frames.
        """
        if len(self.shots) < parts:
            raise DataFolderError(
                f"{self.folder} has {len(self.shots)} frames for {parts} robots: give a smaller "
                "--split, or a smaller --every"
            )
        if not in_turn:
            return [self._with(f"{self.name}-{k}", self.shots[k::parts]) for k in range(parts)]
        cuts = np.linspace(0, len(self.shots), parts + 1).round().astype(int)
        return [
            self._with(f"{self.name}-{k}", self.shots[a:b])
            for k, (a, b) in enumerate(pairwise(cuts))
        ]

    def frames(self, folder: Path) -> Iterator[Frame | None]:
        """A frame for each shot, None for a damaged one, as the robot's camera reads them out of
        the folder that it gets.

        Raises:
            FleetPoseError: they cannot be read.
        """
        with closing(open_camera(self.camera, str(self.stripped(folder)), "once")) as camera:
            for shot, frame in zip(self.shots, camera.frames(), strict=False):
                yield replace(frame, stamp_ns=shot.stamp_ns)

    def stripped(self, folder: Path) -> Path:
        """Makes the folder that the robot gets."""
        folder.mkdir(parents=True)
        for shot in self.shots:
            for file in shot.files:
                _link(folder / file.relative_to(self.folder), file)
        for name, file in self.linked.items():
            _link(folder / name, file)
        for name, text in self.written.items():
            (folder / name).write_text(text)
        for k, name in enumerate(self.lists):
            rows = (
                f"{shot.stamp_ns / 1e9:.9f} {shot.files[k].relative_to(self.folder)}\n"
                for shot in self.shots
            )
            (folder / name).write_text("".join(rows))
        return folder

    def _with(self, name: str, shots: Sequence[Shot]) -> "RecordedSequence":
        return replace(self, name=name, shots=tuple(shots))


def _link(place: Path, file: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    if not place.exists():
        place.symlink_to(file.absolute())
