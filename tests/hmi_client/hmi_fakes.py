"""Messages of a small fleet, for tests of the operator's clients."""

import math
import time
from collections.abc import Callable

import numpy as np

from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import (
    Alignment,
    Camera,
    FleetState,
    NoiseModel,
    PairCell,
    Question,
    RobotPose,
    RobotState,
    Salient,
    ScatteredCloud,
    ServerStatus,
    View,
    ViewName,
)

EPOCH = "0123456789ab"
ROBOT_EPOCH = "a0b1c2d3e4f5"
NO_DEPTH_U = 600.0  # a click right of it is rejected


def view(robot: str, seq: int = 7) -> ViewName:
    return ViewName(robot=robot, epoch=ROBOT_EPOCH, seq=seq)


def pose(robot: str, x: float, y: float, heading: float = 0.0, **changes) -> RobotPose:
    c, s = math.cos(heading), math.sin(heading)
    T = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    fields = {
        "robot": robot,
        "view": view(robot),
        "stamp_ns": 0,
        "T_fleet_robot": T,
        "covariance": np.diag([1e-6, 1e-6, 1e-5, 4e-4, 2e-4, 1e-4]),
        "component": "r1",
        "located": True,
        "verdict": "verified",
        "gauge_revision": 0,
        "jumped": False,
        "age_s": 0.3,
        "valid_until_ns": 5 * 10**9,
        "server_epoch": EPOCH,
        "n": 1,
    }
    return RobotPose(**(fields | changes))


def ring(count: int, seq: int = 7) -> tuple[RobotState, ...]:
    """Robots on an arc of 5 m radius; the last has no pose, the one before stands apart."""
    states = []
    for k in range(count):
        name = f"r{k + 1}"
        angle = 0.35 * k
        p = pose(name, 5 * math.sin(angle), 5 - 5 * math.cos(angle), angle, view=view(name, seq))
        why = ""
        if k and k == count - 1:
            p, why = None, "alive, but no pair of it could be aligned"
        elif k > 3 and k == count - 2:
            p = p.model_copy(update={"located": False, "component": name})
            why = "not joined to the anchor"
        states.append(
            RobotState(
                robot=name,
                alive=True,
                newest_view=view(name, seq),
                views_kept=5,
                pose=p,
                why_not=why,
            )
        )
    return tuple(states)


def cells_of(names: list[str]) -> tuple[PairCell, ...]:
    """Neighbours are aligned, the second next rejected or through others, the rest never tried."""
    cells = []
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            i, j = ordered_pair(names[a], names[b])
            gap = b - a
            if gap == 1:
                cell = PairCell(
                    i=i, j=j, state="tried", verdict="verified", rmse_m=0.01 * b, overlap=0.5
                )
            elif gap == 2:
                verdict, rmse_m = ("plausible", 0.05 + 0.01 * b) if a % 2 else ("rejected", None)
                cell = PairCell(i=i, j=j, state="tried", verdict=verdict, rmse_m=rmse_m)
            elif gap == 3:
                cell = PairCell(i=i, j=j, state="through_others")
            else:
                cell = PairCell(i=i, j=j, state="untried")
            cells.append(cell)
    return tuple(cells)


def fleet(count: int = 6, n: int = 1, seq: int = 7, **changes) -> FleetState:
    robots = ring(count, seq)
    names = [r.robot for r in robots]
    questions = ()
    if count > 2:
        i, j = ordered_pair(names[-2], names[-1])
        reason = "it would join two parts of the fleet"
        questions = (
            Question(i=i, j=j, view_i=view(i), view_j=view(j), reason=reason, gain=0.42),
            Question(i="r1", j="r2", view_i=view("r1"), view_j=view("r2"), reason="weak", gain=0.1),
        )
    fields = {
        "server_epoch": EPOCH,
        "n": n,
        "stamp_ns": 0,
        "anchor": "r1" if count else None,
        "gauge_revision": 0,
        "up_assumed": False,
        "robots": robots,
        "pairs": cells_of(names),
        "questions": questions,
        "events": ("fleet solved with 4 robots",),
    }
    return FleetState(**(fields | changes))


def status(n: int = 1, epoch: str = EPOCH) -> ServerStatus:
    return ServerStatus(
        server_epoch=epoch,
        uptime_s=0.2 * n,
        views=10 * n,
        alignments=n,
        solves=n,
        pending_jobs=2,
        workers=2,
        pairs_per_s=3.5,
        other_cpu_ms_per_view=4.0,
        max_pair_wait_s=1.2,
        drops={"codec": 1},
        version="0.1.0",
    )


def alignment(i: str, j: str, **changes) -> Alignment:
    fields = {
        "view_i": view(i),
        "view_j": view(j),
        "T_i_j": None,
        "covariance": None,
        "information": None,
        "verdict": "rejected",
        "reasons": ("only 4 inliers, need 12", "overlap 3 %"),
        "regression_error_m2": 0.0,
        "regression_count": 0,
        "rmse_m": 0.2,
        "overlap": 0.03,
        "inliers": 4,
        "start": "features",
        "timings_ms": {},
        "server_epoch": EPOCH,
        "n": 1,
    }
    return Alignment(**(fields | changes))


CAMERA = Camera(
    width=640,
    height=480,
    K=np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
    T_robot_camera=np.eye(4),
    noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.01)),
    kind="views",
)


def empty_view(name: ViewName) -> View:
    cloud = ScatteredCloud(count=0, pixel_step_px=1 / 64, depth_step_m=0.001, data=b"")
    salient = Salient(extractor="rootsift", count=0, descriptor_bytes=128, data=b"")
    return View(name=name, stamp_ns=0, camera=CAMERA, cloud=cloud, salient=salient)


def wait_for(condition: Callable[[], object], timeout_s: float = 10.0) -> None:
    """Polls until a condition holds; fails after the timeout."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "did not come true in time"
        time.sleep(0.02)
