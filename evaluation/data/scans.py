"""Clouds without images as a recording: scans with `poses.txt`, or one pair with its truth.

`poses.txt` has a line for each scan in the order of their names: the 12 numbers of the upper rows
of T_world_scan, as KITTI writes them. A pair is `source` and `target` with `T_target_source.txt`.
Scans have a robot's axes: x ahead, y left, z up.
"""

from pathlib import Path

import numpy as np

from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.metrics.geometry import Floats, nearest_rotation, rigid
from fleetpose.protocol.errors import DataFolderError

POSES, PAIR_TRUTH = "poses.txt", "T_target_source.txt"


def is_scans(directory: Path) -> bool:
    """Whether a folder holds scans with their truth."""
    return any((directory / name).is_file() for name in (POSES, PAIR_TRUTH))


def open_scans(directory: Path) -> Recording:
    """Opens such a folder.

    Raises:
        DataFolderError: a scan or its pose is missing, or cannot be read.
    """
    from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
    from fleetpose.robot_agent.cameras.folders.cloud import read_frame, scans_in

    files = scans_in(directory)
    if (directory / POSES).is_file():
        poses = _poses(directory / POSES, len(files))
    else:
        files = [path for name in ("target", "source") for path in files if path.stem == name]
        if len(files) != 2:
            raise DataFolderError(f"{directory} needs a scan 'source' and a scan 'target'")
        poses = [np.eye(4), *_poses(directory / PAIR_TRUTH, 1)]
    views = []
    for index, (path, T_world_scan) in enumerate(zip(files, poses, strict=True)):
        frame = read_frame(path)
        if frame is None:
            continue
        views.append(
            TrueView(
                index=index,
                name=path.stem,
                image=path,
                cloud=path,
                width=frame.model.width,
                height=frame.model.height,
                K=frame.model.K,
                T_world_camera=T_world_scan @ ROBOT_FROM_CAMERA,
            )
        )
    return Recording(directory, None, tuple(views))


def scan_points(path: Path) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and camera-frame points (N, 3) that a robot sends of a scan.

    Raises:
        DataFolderError: it cannot be read or nothing of it lies ahead.
    """
    from fleetpose.protocol.clouds import lift
    from fleetpose.robot_agent.cameras.base import DepthImage, ScatteredPoints
    from fleetpose.robot_agent.cameras.folders.cloud import read_frame

    frame = read_frame(path)
    if frame is None:
        raise DataFolderError(f"{path} has no points ahead")
    if isinstance(frame.ranges, DepthImage):
        rows, columns = np.nonzero(np.isfinite(frame.ranges.depth_m))
        uv = np.column_stack((columns, rows)).astype(np.float64)
        return uv, lift(uv, frame.ranges.depth_m[rows, columns].astype(np.float64), frame.model.K)
    assert isinstance(frame.ranges, ScatteredPoints)
    return frame.ranges.uv, lift(frame.ranges.uv, frame.ranges.z, frame.model.K)


def _poses(path: Path, count: int) -> list[Floats]:
    try:
        numbers = np.loadtxt(path, np.float64).ravel()
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} holds no poses: {error}") from error
    per_pose = 16 if len(numbers) == 16 * count else 12
    if len(numbers) != per_pose * count or not count:
        raise DataFolderError(f"{path} holds {len(numbers)} numbers, need 12 for each of {count}")
    stacked = numbers.reshape(count, -1)[:, :12].reshape(count, 3, 4)
    return [rigid(nearest_rotation(one[:, :3]), one[:, 3]) for one in stacked]
