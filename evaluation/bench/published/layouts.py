"""The folders of known benchmarks: where their images, calibrations and truth are."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.published.sequences import RecordedSequence, Shot
from fleetpose.evaluation.metrics.geometry import Floats, nearest_rotation, rigid
from fleetpose.formats.arrays import FormatError
from fleetpose.formats.kitti import read_kitti, read_times
from fleetpose.formats.rotations import pose_of
from fleetpose.formats.text import lines_of, nanoseconds
from fleetpose.formats.tum import read_tum
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.calibrations.lens import numbers
from fleetpose.robot_agent.cameras.calibrations.tree import read_tree
from fleetpose.robot_agent.cameras.folders.pairing import eyes_of, list_images, paired
from fleetpose.robot_agent.cameras.rgbd.layouts import layout_of

NEAREST_NS = 10_000_000  # from a frame to the truth that counts for it: as evo has it
_KINECT = "585 0 320\n0 585 240\n0 0 1\n"
_INTRINSICS = "camera-intrinsics.txt"


@dataclass(frozen=True)
class Layout:
    """How the folders of a benchmark are read.

    Attributes:
        open: makes the sequence of the data's folder and the robot's name.
        every: of its frames a robot sends each so-manieth: about two a second.
    """

    open: Callable[[Path, str], RecordedSequence]
    every: int


def open_sequence(layout: str, data: Path, name: str) -> RecordedSequence:
    """Opens what a robot saw.

    Raises:
        DataFolderError: it is not there, has no truth, or is not laid out so.
    """
    try:
        sequence = LAYOUTS[layout].open(data, name)
    except FormatError as error:
        raise DataFolderError(str(error)) from error
    if not any(shot.T_world_camera is not None for shot in sequence.shots):
        raise DataFolderError(f"{sequence.folder}: no frame has a true pose near its time")
    return sequence


def robot_name(name: str) -> str:
    """A sequence's name as one that a robot can have."""
    return re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[-28:].lstrip("-_") or "robot"


def _folder(*places: Path) -> Path:
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        raise DataFolderError(f"there is no folder {' nor '.join(map(str, places))}")
    return found


def _euroc(data: Path, name: str) -> RecordedSequence:
    """`NAME/mav0`: the truth is the body's, the camera's place on it stands in its sensor.yaml."""
    folder = _folder(data / name)
    sensors = [Path("mav0", eye, "sensor.yaml") for eye in ("cam0", "cam1")]
    where = folder / sensors[0]
    T_body_camera = numbers(read_tree(where), "T_BS", str(where), 16).reshape(4, 4)
    stamps_ns, T_world_bodies = _euroc_truth(
        folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    )
    shots = []
    for pair in _stereo(folder):
        stamp_ns = int(pair[0].stem)
        T = _nearest(stamps_ns, T_world_bodies, stamp_ns)
        shots.append(Shot(pair, stamp_ns, None if T is None else T @ T_body_camera))
    linked = {str(sensor): folder / sensor for sensor in sensors}
    return RecordedSequence(robot_name(name), folder, "stereo", tuple(shots), linked)


def _euroc_truth(path: Path) -> tuple[np.ndarray, Floats]:
    """Stamps and T_world_body: time, place, quaternion (w, x, y, z), and what is not needed."""
    stamps_ns, poses = [], []
    for number, line in enumerate(lines_of(path), 1):
        words = line.partition("#")[0].split(",")
        if len(words) < 8:
            continue
        try:
            stamps_ns.append(int(words[0]))
            values = np.array(words[1:8], np.float64)
        except ValueError as error:
            raise FormatError(f"{path}, line {number}: {error}") from error
        poses.append(pose_of(values[3:], values[:3]))
    return np.array(stamps_ns, np.int64), np.array(poses).reshape(-1, 4, 4)


def _kitti(data: Path, name: str) -> RecordedSequence:
    """`sequences/NAME` with `poses/NAME.txt`, of the left grey camera; or one street alone: images
    of two eyes with a calibration, and `truth/poses.txt` as TUM writes it.
    """
    folder = _folder(data / "sequences" / name, data / name)
    alone = folder / "truth" / "poses.txt"
    poses = read_tum(alone)[1] if alone.is_file() else read_kitti(data / "poses" / f"{name}.txt")
    times = folder / "times.txt"
    pairs = _stereo(folder)
    stamps_ns = read_times(times) if times.is_file() else np.arange(len(pairs)) * 10**8
    if not len(pairs) == len(poses) == len(stamps_ns):
        raise DataFolderError(
            f"{folder} has {len(pairs)} pairs of images, {len(stamps_ns)} times and {len(poses)} "
            "poses: they must be as many"
        )
    shots = [Shot(*one) for one in zip(pairs, stamps_ns.tolist(), poses, strict=True)]
    linked = _those_there(folder, "calib.txt", "stereo.json")
    return RecordedSequence(robot_name(name), folder, "stereo", tuple(shots), linked)


def _tum(data: Path, name: str) -> RecordedSequence:
    """`NAME` with rgb.txt, depth.txt and groundtruth.txt."""
    folder = _folder(data / name)
    stamps_ns, poses = read_tum(folder / "groundtruth.txt")
    at = {}
    for line in lines_of(folder / "rgb.txt"):
        words = line.partition("#")[0].split()
        if len(words) >= 2:
            at[folder / words[1]] = nanoseconds(folder / "rgb.txt", words[0])
    shots = [
        Shot((one.colour, one.depth), at[one.colour], _nearest(stamps_ns, poses, at[one.colour]))
        for one in layout_of(folder).shots
    ]
    linked = _those_there(folder, _INTRINSICS)
    lists = ("rgb.txt", "depth.txt")
    return RecordedSequence(robot_name(name), folder, "rgbd", tuple(shots), linked, {}, lists)


def _seven_scenes(data: Path, name: str) -> RecordedSequence:
    """`NAME` with frame-*.pose.txt; 30 Hz, and f 585 px where no file tells another."""
    folder = _folder(data / name)
    shots = []
    for k, one in enumerate(layout_of(folder).shots):
        pose = one.depth.with_name(one.depth.name.replace(".depth.png", ".pose.txt"))
        T = np.loadtxt(pose).reshape(4, 4) if pose.is_file() else np.full((4, 4), np.nan)
        good = np.isfinite(T).all()
        true = rigid(nearest_rotation(T[:3, :3]), T[:3, 3]) if good else None
        shots.append(Shot((one.colour, one.depth), k * 10**9 // 30, true))
    linked = _those_there(folder, _INTRINSICS, "calib.json")
    written = {} if _INTRINSICS in linked else {_INTRINSICS: _KINECT}
    return RecordedSequence(robot_name(name), folder, "rgbd", tuple(shots), linked, written)


def _replica(data: Path, name: str) -> RecordedSequence:
    """`NAME` with results/ and traj.txt, 16 numbers a line; cam_params.json there or above."""
    folder = _folder(data / name)
    rows = np.array([line.split() for line in lines_of(folder / "traj.txt") if line], np.float64)
    found = layout_of(folder).shots
    if rows.shape != (len(found), 16):
        raise DataFolderError(f"{folder}/traj.txt has {rows.shape[0]} poses, {len(found)} frames")
    shots = [
        Shot((one.colour, one.depth), k * 10**9 // 30, rigid(nearest_rotation(T[:3, :3]), T[:3, 3]))
        for k, (one, T) in enumerate(zip(found, rows.reshape(-1, 4, 4), strict=True))
    ]
    places = (folder, *folder.parents[:3])
    known = next((p for at in places if (p := at / "cam_params.json").is_file()), None)
    linked = {} if known is None else {"cam_params.json": known}
    return RecordedSequence(robot_name(name), folder, "rgbd", tuple(shots), linked)


def _those_there(folder: Path, *names: str) -> dict[str, Path]:
    return {name: folder / name for name in names if (folder / name).is_file()}


def _stereo(folder: Path) -> Sequence[tuple[Path, Path]]:
    left, right = eyes_of(folder)
    return paired(list_images(left), list_images(right))


def _nearest(stamps_ns: np.ndarray, poses: npt.ArrayLike, stamp_ns: int) -> Floats | None:
    """The true pose next in time to a frame, if there is one near enough."""
    if not len(stamps_ns):
        return None
    k = int(np.argmin(np.abs(stamps_ns - stamp_ns)))
    near = abs(int(stamps_ns[k]) - stamp_ns) <= NEAREST_NS
    return np.asarray(poses, np.float64)[k] if near else None


LAYOUTS = {
    "euroc": Layout(_euroc, 10),
    "kitti": Layout(_kitti, 3),
    "tum": Layout(_tum, 15),
    "7scenes": Layout(_seven_scenes, 15),
    "replica": Layout(_replica, 15),
}
