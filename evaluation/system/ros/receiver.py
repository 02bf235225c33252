"""What it costs to have a robot's frames, without any work on them: a process that takes them at an
agent's pace and says what it took.
"""

import json
import logging
import sys
import threading
import time

import numpy as np

from fleetpose.protocol.logs import log_to_stderr
from fleetpose.robot_agent.agent import paced
from fleetpose.robot_agent.cameras.ros.camera import open_camera
from fleetpose.robot_agent.cameras.ros.options import RosOptions


def main(endpoint: str, namespace: str, seconds: float, rate_hz: float) -> None:
    """Takes frames for a while; prints megabytes a second, the share of a core, and ages."""
    log_to_stderr(logging.INFO)
    stop = threading.Event()
    camera = open_camera(endpoint, "once", ros=RosOptions(namespace=namespace), stop=stop)
    ages_ms: list[float] = []
    try:
        frames = paced(camera.frames(), rate_hz, stop)
        next(frames)  # what is compiled or loaded once is not counted
        cpu_s, begin_s, taken = time.process_time(), time.monotonic(), camera.network.taken_bytes
        for frame in frames:
            ages_ms.append(1e-6 * (time.time_ns() - frame.stamp_ns))
            if time.monotonic() - begin_s > seconds:
                break
        elapsed_s = time.monotonic() - begin_s
        told = {
            "frames": len(ages_ms),
            "mb_per_s": 1e-6 * (camera.network.taken_bytes - taken) / elapsed_s,
            "core_percent": 100 * (time.process_time() - cpu_s) / elapsed_s,
            "age_ms": float(np.median(ages_ms)),
        }
        print(json.dumps(told), flush=True)
    finally:
        camera.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4]))
