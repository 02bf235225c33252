"""A folder of posed views: `cameras.json`, images, clouds."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.data.recording import CLOUD_KINDS, Recording, TrueView, npz_name
from fleetpose.evaluation.metrics.geometry import Floats, inverse, nearest_rotation, rigid
from fleetpose.evaluation.options.names import CloudKind
from fleetpose.protocol.errors import DataFolderError

_LEAST_POINTS = 10


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} cannot be read: {error}") from error


def camera_entry(
    name: str, size: tuple[int, int], K: Floats, T_camera_world: Floats
) -> dict[str, Any]:
    """A camera as `cameras.json` holds it."""
    return {
        "name": name,
        "width": size[0],
        "height": size[1],
        "K": K.tolist(),
        "R_world_to_cam": T_camera_world[:3, :3].tolist(),
        "t_world_to_cam": T_camera_world[:3, 3].tolist(),
    }


def open_posed_views(directory: Path, clouds: CloudKind | None) -> Recording:
    """Opens such a folder with the clouds of a kind."""
    there: list[CloudKind] = [kind for kind in CLOUD_KINDS if (directory / kind).is_dir()]
    clouds = clouds or (there[0] if len(there) == 1 else "sparse_noisy")
    if clouds not in there:
        raise DataFolderError(
            f"{directory} has no clouds '{clouds}'; --clouds can be {', '.join(there)}"
        )
    folder = directory / clouds
    index_path = folder / "index.json"
    partners = _json(index_path) if index_path.exists() else {}
    entries = _json(directory / "cameras.json")
    entries = entries["cameras"] if isinstance(entries, dict) else entries
    try:
        entries = sorted(entries, key=lambda entry: entry["name"])
        views = tuple(
            _posed_view(directory, folder, number, entry, partners.get(entry["name"], {}))
            for number, entry in enumerate(entries)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise DataFolderError(f"{directory}/cameras.json: {error!r} in a camera") from error
    return Recording(directory, clouds, views)


def _posed_view(
    directory: Path, folder: Path, index: int, entry: dict[str, Any], pair: dict[str, Any]
) -> TrueView:
    R = nearest_rotation(np.asarray(entry["R_world_to_cam"], np.float64).reshape(3, 3))
    t = np.asarray(entry["t_world_to_cam"], np.float64).reshape(3)
    cloud = folder / npz_name(entry["name"])
    ring_angle = entry.get("ring_angle_deg")
    return TrueView(
        index=index,
        name=entry["name"],
        image=directory / "images" / entry["name"],
        cloud=cloud if _has_points(cloud) else None,
        width=int(entry["width"]),
        height=int(entry["height"]),
        K=np.asarray(entry["K"], np.float64).reshape(3, 3),
        T_world_camera=inverse(rigid(R, t)),
        partner=pair.get("partner"),
        baseline_m=pair.get("baseline_m"),
        ring_angle_deg=None if ring_angle is None else float(ring_angle),
    )


def _has_points(cloud: Path) -> bool:
    """Whether there is a cloud that a robot could send: where it sees nothing it has none."""
    if not cloud.exists():
        return False
    with np.load(cloud) as arrays:
        return len(arrays["uv"]) >= _LEAST_POINTS
