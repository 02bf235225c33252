"""`pose-eval stereo`: a stereo video played as a device would give it; calibrations good and bad.

The robot's own code is measured: its camera opens the file, `robot-agent calibrate-check` runs as a
process, and so does an agent whose memory and processor time are read.
"""

import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.report.output import output_folder, print_table, write_csv, write_summary
from fleetpose.evaluation.simulate.stereo_video import (
    BOARD,
    FPS,
    FRAMES_PER_STATION,
    SQUARE_M,
    StereoVideo,
    make_video,
)
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
from fleetpose.robot_agent.cameras.base import DisparityImage, Frame
from fleetpose.robot_agent.cameras.stereo.matching import open_camera
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig, content_of

AGENT_VIEWS = 15
CHECK_PAIRS = 5
_RING_SHARE = 0.25  # as far from the robot as the ring's middle, give or take
_MB = 1024.0 * 1024.0
_FRAME_COLUMNS = ("frame", "station", "error_median", "error_ring_median", "coverage", "cpu_ms")


def run(out: Path) -> dict[str, Any]:
    """Measures, writes frames.csv, checks.json and summary.json, prints a table.

    Args:
        out: folder for the results, made where needed; the video is kept there.

    Returns:
        The summary.

    Raises:
        FleetPoseError: the folder or the video cannot be made, or a process fails.
    """
    out = output_folder(out)
    video = make_video(out / "stereo.mkv")
    right = out / "stereo.json"
    right.write_text(json.dumps(content_of(video.rig)))
    frames = list(depth_errors(video, right))
    write_csv(out / "frames.csv", _FRAME_COLUMNS, frames)
    checks = [
        checked(name, rig, expects, video, out) for name, rig, expects in calibrations(video.rig)
    ]
    (out / "checks.json").write_text(json.dumps(checks, indent=1) + "\n")
    summary = {
        "frames": len(frames),
        "depth_error_median": _median(frames, "error_median"),
        "depth_error_ring_median": _median(frames, "error_ring_median"),
        "coverage": _median(frames, "coverage"),
        "frame_ms": _median(frames, "cpu_ms"),
        **agent_load(video.path, right),
        "checks": {
            check["calibration"]: {key: check[key] for key in ("named", "verdict", "sentence")}
            for check in checks
        },
    }
    write_summary(out, summary)
    _show(summary)
    return summary


def depth_errors(video: StereoVideo, calibration: Path) -> Iterator[dict[str, Any]]:
    """The video once through, at its own pace: share by which depths are off, per frame taken."""
    camera = open_camera(str(video.path), "once", calibration)
    references: list[np.ndarray] = []
    started_s = time.process_time()
    try:
        for number, frame in enumerate(camera.frames()):
            cpu_ms = 1e3 * (time.process_time() - started_s)
            station = _station(frame, references)
            yield {"frame": number, "station": station, "cpu_ms": cpu_ms} | _errors(
                frame, station, video
            )
            started_s = time.process_time()
    finally:
        camera.close()


def calibrations(rig: StereoRig) -> Iterator[tuple[str, StereoRig, str]]:
    """Calibrations, right and wrong, with a pattern of what must be said; empty: that it fits.

    A turned one is that of a right camera that has been turned where it stands.
    """
    yield "right", rig, ""
    longer = rig.T_right_left.copy()
    longer[:3, 3] *= 1.05
    pattern = r"baseline is (?:4\.[5-9]|5\.[0-5]) % too long"
    yield "baseline_plus_5_percent", replace(rig, T_right_left=longer), pattern
    for axis, name in enumerate("xyz"):
        turned = rig.T_right_left.copy()
        turned[:3] = cv2.Rodrigues(np.radians(2.0) * np.eye(3)[axis])[0] @ turned[:3]
        pattern = rf"turned by [+-](?:1\.9|2\.0)\d deg \(sigma [\d.]+\) about {name}"
        yield f"turned_2_deg_{name}", replace(rig, T_right_left=turned), pattern


def checked(
    name: str, rig: StereoRig, expects: str, video: StereoVideo, out: Path
) -> dict[str, Any]:
    """What `calibrate-check` says of a calibration, and whether it names what is wrong."""
    file = out / f"{name}.json"
    file.write_text(json.dumps(content_of(rig)))
    interval_s = 0.95 * FRAMES_PER_STATION / FPS
    command = [
        *(sys.executable, "-P", "-m", "fleetpose.robot_agent", "calibrate-check", "--json"),
        *("--data", str(video.path), "--calibration", str(file)),
        *("--pairs", str(CHECK_PAIRS), "--interval", str(interval_s)),
        *("--length", str(SQUARE_M), "--board", f"{BOARD[0]}x{BOARD[1]}"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if done.returncode not in (0, 1):
        raise FleetPoseError(f"calibrate-check failed on {name}: {done.stderr.strip()}")
    report = json.loads(done.stdout)
    if expects:
        named = report["verdict"] == "does not fit" and re.search(expects, report["sentence"])
    else:
        named = report["verdict"] == "fits"
    return {"calibration": name, "exit_code": done.returncode, "named": bool(named), **report}


def agent_load(video: Path, calibration: Path) -> dict[str, float]:
    """Largest memory of an agent that plays the video at one view per second, and its processor
    time per view, salient points and sending included.
    """
    import psutil

    with tempfile.TemporaryDirectory() as folder, LocalFleet(Path(folder)) as fleet:
        fleet.start_router()
        options = ("--calibration", str(calibration), "--replay", "loop", "--rate", "1")
        fleet.start_robot("r1", "stereo", str(video.absolute()), *options)
        process = psutil.Process(fleet.pid("r1"))
        resident: list[float] = []

        def views() -> int:
            resident.append(process.memory_info().rss / _MB)
            return fleet.tail("r1", 10_000).count(" view name=")

        _wait_views(fleet, lambda: views() >= 1)
        first, before = views(), process.cpu_times()
        _wait_views(fleet, lambda: views() >= first + AGENT_VIEWS)
        last, after = views(), process.cpu_times()
        cpu_s = after.user + after.system - before.user - before.system
    return {"agent_rss_mb": max(resident), "agent_cpu_ms_per_view": 1e3 * cpu_s / (last - first)}


def _wait_views(fleet: LocalFleet, arrived: Callable[[], bool]) -> None:
    if not wait_running(fleet, arrived, 60.0 + AGENT_VIEWS):
        raise FleetPoseError(f"the agent sends too few views; its log ends:\n{fleet.tail('r1')}")


def _station(frame: Frame, references: list[np.ndarray]) -> int:
    """Where a frame was taken: at the last place, or the next if it looks different."""
    image = frame.image[::4, ::4].astype(np.int16)
    if not references or np.abs(image - references[-1]).mean() > 10:
        references.append(image)
    return len(references) - 1


def _errors(frame: Frame, station: int, video: StereoVideo) -> dict[str, float]:
    assert isinstance(frame.ranges, DisparityImage)
    T_left_camera = np.linalg.inv(ROBOT_FROM_CAMERA) @ frame.model.T_robot_camera
    true = video.true_depth(station, T_left_camera, frame.model.K)
    measured = frame.ranges.focal_baseline_px_m / frame.ranges.disparity_px
    seen, there = np.isfinite(measured), np.isfinite(true)
    error = np.abs(measured - true) / true
    ring = np.abs(true / video.radius_m - 1) < _RING_SHARE
    return {
        "error_median": float(np.median(error[seen & there])),
        "error_ring_median": float(np.median(error[seen & there & ring])),
        "coverage": float(seen[there].mean()),
    }


def _median(rows: list[dict[str, Any]], name: str) -> float:
    return float(np.median([row[name] for row in rows]))


def _show(summary: dict[str, Any]) -> None:
    numbers = [(name, value) for name, value in summary.items() if name != "checks"]
    print_table("stereo video of the synthetic world", ("figure", "value"), numbers)
    print_table(
        "robot-agent calibrate-check",
        ("calibration", "named", "verdict"),
        [(name, str(c["named"]), c["verdict"]) for name, c in summary["checks"].items()],
    )
    for name, check in summary["checks"].items():
        print(f"{name}: {check['sentence']}")
