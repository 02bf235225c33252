"""A camera whose driver flips its images, as a folder: `pose-eval pairs --mirror-share`.

Images and depths are flipped alike, and the intrinsics stay as they were: that is what such drivers
do.
"""

import json
from pathlib import Path

import cv2
import numpy as np

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 98]


def mirror_folder(folder: Path) -> None:
    """Flips all images, depths and clouds of a stripped folder, in place."""
    for path in sorted(folder.rglob("*.png")) + sorted(folder.rglob("*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is not None:
            cv2.imwrite(str(path), np.ascontiguousarray(image[:, ::-1]), _QUALITY)
    if (folder / "cameras.json").exists():
        for camera in json.loads((folder / "cameras.json").read_text())["cameras"]:
            cloud = folder / "clouds" / Path(camera["name"]).with_suffix(".npz").name
            _mirror_cloud(cloud, np.array(camera["K"]), camera["width"])


def _mirror_cloud(path: Path, K: np.ndarray, width: int) -> None:
    with np.load(path) as arrays:
        uv, points = arrays["uv"].copy(), arrays["xyz_cam"].copy()
    uv[:, 0] = width - 1 - uv[:, 0]
    homogeneous = np.column_stack((uv, np.ones(len(uv)))).astype(np.float64)
    points = (homogeneous @ np.linalg.inv(K).T * points[:, 2:]).astype(points.dtype)
    np.savez(path, uv=uv, xyz_cam=points)
