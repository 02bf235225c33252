"""Benchmarks that come as ROS bags: which topics are the eyes, and where the truth lies."""

import re
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from fleetpose.evaluation.bench.bags.places import found
from fleetpose.evaluation.bench.published.layouts import robot_name
from fleetpose.evaluation.bench.published.sequences import RecordedSequence, Shot
from fleetpose.evaluation.bench.published.truths import read_truth
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.bag.options import BagOptions, StampSource
from fleetpose.robot_agent.cameras.bag.recording import BagRecording
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.rosmsg.bag import Bag

_CALIBRATIONS = (".json", ".yaml", ".yml", ".txt", ".ini", ".conf")


@dataclass(frozen=True)
class BagLayout:
    """How the bags of a benchmark are read; NAME stands for the robot's.

    Attributes:
        left, right: topics of the eyes.
        truths: where the truth may lie, below the data's folder.
        every: of its frames a robot sends each so-manieth: about two a second.
        told: what its truth is of, and what that means for the error.
    """

    left: str
    right: str
    truths: tuple[str, ...]
    every: int
    told: str


@dataclass(frozen=True, eq=False)
class BagSequence(RecordedSequence):
    """What one robot saw, in bags: their topics of truth are read by nobody.

    Attributes:
        source: the bags, with commas between.
        options: its topics, and whose stamps count.
        calibration: where its infos are missing.
    """

    source: str = ""
    options: BagOptions = field(default_factory=BagOptions)
    calibration: Path | None = None

    def frames(self, folder: Path) -> Iterator[Frame | None]:
        """See `RecordedSequence`; nothing is written into the folder."""
        wanted = {shot.stamp_ns for shot in self.shots}
        with closing(self.recording()) as recording:
            for moment in recording.moments():
                if moment.stamp_ns in wanted:
                    yield recording.frame(moment)

    def recording(self) -> BagRecording:
        """Opens its bags.

        Raises:
            FleetPoseError: they cannot be read, or lack infos and no calibration is given.
        """
        bag = Bag(self.source)
        try:
            return BagRecording(bag, self.options, self.calibration)
        except Exception:
            bag.close()
            raise


_GT = ("NAME_gt.txt", "NAME_gt.tum", "NAME.txt", "NAME_gt_odom.csv", "NAME.csv")
_TRUTHS = tuple(f"{folder}{name}" for folder in ("", "gt/", "ground_truth/") for name in _GT)
_ANTENNA = (
    "the truth is where an RTK antenna was, positions only: how far it is from the camera is part "
    "of the error"
)
_BODY = (
    "the truth is of the robot's body: how far its origin is from the camera is part of the error"
)
BAG_LAYOUTS = {
    "s3e": BagLayout(
        "/NAME/left_camera/compressed", "/NAME/right_camera/compressed", _TRUTHS, 5, _ANTENNA
    ),
    "kimera-multi": BagLayout(
        "/NAME/forward/infra1/image_rect_raw/compressed",
        "/NAME/forward/infra2/image_rect_raw/compressed",
        _TRUTHS,
        8,
        _BODY,
    ),
    "graco": BagLayout("/camera_left/image_raw", "/camera_right/image_raw", _TRUTHS, 10, _BODY),
}


def open_bags(
    layout: str, data: Path, name: str, stamps: StampSource, calibration: Path | None
) -> BagSequence:
    """Opens what a robot saw: of a bag that holds all robots its topics, else the bags that are
    called like it.

    Raises:
        DataFolderError: there is no bag, no truth, or no frame near a true position.
        FleetPoseError: a bag cannot be read, or needs a calibration.
    """
    known = BAG_LAYOUTS[layout]
    source = ",".join(str(bag) for bag in _bags_of(data, name))
    left, right = (topic.replace("NAME", name) for topic in (known.left, known.right))
    options = BagOptions(left=left, right=right, stamps=stamps)
    own = _calibration_of(calibration, name)
    truth = read_truth(_truth_of(data, name, known.truths))
    empty = BagSequence(
        robot_name(name), data, "bag", (), source=source, options=options, calibration=own
    )
    with closing(empty.recording()) as recording:
        stamps_ns = [moment.stamp_ns for moment in recording.moments()]
    shots = tuple(Shot((), at_ns, truth.at(at_ns)) for at_ns in stamps_ns)
    if not any(shot.T_world_camera is not None for shot in shots):
        span = f"{1e-9 * stamps_ns[0]:.1f} s on" if stamps_ns else "none"
        raise DataFolderError(
            f"{source}: no frame has a true position near its time (frames from {span}, truth "
            f"from {1e-9 * truth.stamps_ns[0]:.1f} s on); try --stamps receive or header"
        )
    return empty._with(empty.name, shots)  # pyright: ignore[reportReturnType]


def _bags_of(data: Path, name: str) -> list[Path]:
    bags = found([data])
    called = [bag for bag in bags if _is_called(bag, name)]
    if called or len(bags) == 1:
        return called or bags
    listed = ", ".join(bag.name for bag in bags[:6])
    raise DataFolderError(f"--robots {name}: no bag below {data} is called so: {listed}")


def _is_called(path: Path, name: str) -> bool:
    """Whether a name is a whole part of a file's: `acl_jackal` is none of `10_14_acl_jackal2`."""
    pattern = rf"(^|[^a-z0-9]){re.escape(name.lower())}([^a-z0-9]|$)"
    return re.search(pattern, path.stem.lower()) is not None


def _calibration_of(place: Path | None, name: str) -> Path | None:
    """A file, or of a folder's files the one that is called like the robot."""
    if place is None or place.is_file():
        return place
    files = [one for one in sorted(place.glob("*")) if one.suffix in _CALIBRATIONS]
    own = [one for one in files if _is_called(one, name)]
    if not own:
        raise DataFolderError(f"--calibration {place}: no file there is called like {name}")
    return own[0]


def _truth_of(data: Path, name: str, places: tuple[str, ...]) -> Path:
    folder = data if data.is_dir() else data.parent
    names = [place.replace("NAME", one) for place in places for one in (name, name.lower())]
    there = next((folder / one for one in names if (folder / one).is_file()), None)
    if there is None:
        raise DataFolderError(
            f"{folder} has no truth of {name}: none of {', '.join(dict.fromkeys(names))}"
        )
    return there


def truth_told(layout: str) -> str:
    """What a benchmark's truth is of; empty where it is the camera's."""
    return BAG_LAYOUTS[layout].told if layout in BAG_LAYOUTS else ""
