"""Where one camera is relative to another, by the library alone: no network and no server.

    python examples/align_two_views.py A.npz B.npz

Each file holds `image` (H, W, 3) uint8 BGR, `depth_m` (H, W) float32 and the intrinsics `K` (3, 3).
"""

import sys
from pathlib import Path

import numpy as np

from fleetpose import Camera, DepthImage, Frame, NoiseModel
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.prepared_view import PreparedView, prepare_view
from fleetpose.protocol.messages import ViewName
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.robot_agent.features.packing import view_of

NOISE = NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.001))  # sigma(z) = 0.001 z^2


def read(file: str) -> PreparedView:
    """A view as the server would have it."""
    seen = np.load(file)
    (height, width), K = seen["depth_m"].shape, seen["K"]
    camera = Camera(
        kind="rgbd", width=width, height=height, K=K, T_robot_camera=np.eye(4), noise=NOISE
    )
    frame = Frame(0, seen["image"], DepthImage(seen["depth_m"]), camera)
    name = ViewName(robot=Path(file).stem, epoch="0" * 12, seq=0)
    return prepare_view(view_of(name, frame, salient_of(frame)))


if __name__ == "__main__":
    found = align_pair(read(sys.argv[1]), read(sys.argv[2]))
    print(found.verdict, *found.reasons)
    print(found.T_i_j)  # camera B in the frame of camera A, metres
