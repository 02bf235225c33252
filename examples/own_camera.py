"""A camera of one's own: whatever yields frames. This one paints a wall 3 m ahead of it.

python examples/own_camera.py NAME METRES_TO_THE_RIGHT [ENDPOINT]
"""

import sys
import time
from collections.abc import Iterator

import numpy as np

from fleetpose import Camera, DepthImage, FleetRobot, Frame, NoiseModel, SessionSettings

WALL_M, FOCAL_PX, WIDTH, HEIGHT = 3.0, 300.0, 320, 240
PAINT = np.random.default_rng(0).integers(0, 256, (24, 60, 3), np.uint8)
WALL = PAINT.repeat(10, axis=0).repeat(10, axis=1)
K = np.array([[FOCAL_PX, 0.0, 159.5], [0.0, FOCAL_PX, 119.5], [0.0, 0.0, 1.0]])
NOISE = NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.01, 0.0, 0.0))
MODEL = Camera(kind="wall", width=WIDTH, height=HEIGHT, K=K, T_robot_camera=np.eye(4), noise=NOISE)


def frames(right_m: float) -> Iterator[Frame]:
    """What it sees from a place along the wall."""
    left = round(right_m * FOCAL_PX / WALL_M)
    image = np.ascontiguousarray(WALL[:, left : left + WIDTH])
    depth_m = np.full((HEIGHT, WIDTH), WALL_M, np.float32)
    while True:
        yield Frame(time.time_ns(), image, DepthImage(depth_m), MODEL)


def main(name: str, right_m: str, endpoint: str = "tcp/127.0.0.1:7447") -> None:
    """Sends a frame each second until Ctrl-C."""
    with FleetRobot(name, SessionSettings(connect=(endpoint,))) as robot:
        for frame in frames(float(right_m)):
            robot.push_frame(frame)
            time.sleep(1.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
