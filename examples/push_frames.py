"""A robot's own program: it sends what its camera sees, and hears where it is. Ctrl-C ends it.

    python examples/push_frames.py NAME FILE.npz [ENDPOINT]

The file stands for the camera: `image` (H, W, 3) uint8 BGR, `depth_m` (H, W) float32, `K` (3, 3).
"""

import sys
import time

import numpy as np

from fleetpose import Camera, FleetRobot, NoiseModel, SessionSettings


def main(name: str, file: str, endpoint: str = "tcp/127.0.0.1:7447") -> None:
    """Pushes a frame each second."""
    seen = np.load(file)
    height, width = seen["depth_m"].shape
    camera = Camera(
        kind="rgbd",
        width=width,
        height=height,
        K=seen["K"],
        T_robot_camera=np.eye(4),
        noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.001)),
    )
    with FleetRobot(name, SessionSettings(connect=(endpoint,)), camera=camera) as robot:
        while True:
            robot.push(seen["image"], seen["depth_m"])
            time.sleep(1.0)
            pose = robot.pose()
            if pose is not None and pose.located and not robot.is_stale(pose):
                print("located", pose.T_fleet_robot.round(3).tolist(), flush=True)
            else:
                print("not located:", robot.why(), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
