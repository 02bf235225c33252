"""Where every robot of the fleet is, each second, until Ctrl-C.

    python examples/follow_poses.py [ENDPOINT]

It joins as a robot that sends nothing. A careful program acts on no pose that is stale or doubted.
"""

import sys
import time

import numpy as np

from fleetpose import FleetRobot, SessionSettings


def main(endpoint: str = "tcp/127.0.0.1:7447") -> None:
    """Prints robot, position and its sigma in metres, and whose frame that is in."""
    with FleetRobot("follower", SessionSettings(connect=(endpoint,))) as follower:
        while True:
            for name, pose in sorted(follower.poses().items()):
                if not pose.located or follower.is_stale(pose):
                    print(name, "not located:", pose.why_not, flush=True)
                    continue
                x, y, z = pose.T_fleet_robot[:3, 3]
                sigma_m = np.sqrt(np.linalg.eigvalsh(pose.covariance[3:, 3:])[-1])
                place = f"{x:.3f} {y:.3f} {z:.3f} +- {sigma_m:.3f}"
                print(name, place, "in the frame of", pose.component, flush=True)
            time.sleep(1.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
