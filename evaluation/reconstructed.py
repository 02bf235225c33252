"""A reconstruction as a folder of posed views, which everything else reads: its points are their
clouds, the same in all views (`sparse`).
"""

import atexit
import json
import shutil
import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from evaluation.report import progress_bar
from robot_agent.reconstructions.bundler import find_bundle, read_bundler

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 98]


def is_reconstruction(folder: Path) -> bool:
    """Whether a folder holds one."""
    return find_bundle(folder) is not None


@cache
def as_posed_views(folder: Path) -> Path:
    """Writes the posed views into a folder that goes with the process.

    Raises:
        DataFolderError: the reconstruction cannot be read; the text names what is wrong.
    """
    model = read_bundler(folder)
    place = Path(tempfile.mkdtemp(prefix="fleetpose-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    out = place / folder.resolve().name
    (out / "images").mkdir(parents=True)
    (out / "sparse").mkdir()
    cameras = []
    with progress_bar() as progress:
        for view in progress.track(model.views, description="images"):
            name = f"{Path(view.name).stem}.jpg"
            cv2.imwrite(str(out / "images" / name), view.picture(), _QUALITY)
            np.savez(
                out / "sparse" / f"{Path(name).stem}.npz",
                uv=view.uv,
                xyz_cam=model.in_camera(view),
                track_id=view.seen,
            )
            T = view.T_camera_world
            cameras.append(
                {
                    "name": name,
                    "width": view.width,
                    "height": view.height,
                    "K": view.K.tolist(),
                    "R_world_to_cam": T[:3, :3].tolist(),
                    "t_world_to_cam": T[:3, 3].tolist(),
                }
            )
    (out / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    return out
