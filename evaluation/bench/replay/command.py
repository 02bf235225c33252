"""`pose-eval replay`: a recorded site put together anew, and its poses beside the recorded ones."""

import logging
import os
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.replay.compare import agreement
from fleetpose.evaluation.bench.replay.inputs import Recorded, heard, site_recording
from fleetpose.evaluation.bench.replay.server import Aligner, ReplayServer
from fleetpose.evaluation.metrics.geometry import quat_wxyz
from fleetpose.evaluation.report.output import (
    COVARIANCE_COLUMNS,
    POSE_COLUMNS,
    output_folder,
    pose_cells,
    progress_bar,
    write_csv,
    write_summary,
)
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Alignment, FleetState, RobotPose, ViewName
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.recording.file import Recording

COLUMNS = (
    *("at_s", "robot", "epoch", "seq", "stamp_ns", "component", "gauge_revision", "located"),
    *("verdict", "jumped", *POSE_COLUMNS, *COVARIANCE_COLUMNS),
)


@dataclass
class Told:
    """What a replayed server said.

    Attributes:
        poses: with their seconds, in order.
        verdicts: of alignments between robots, how often each.
        state: the one in which most robots were located, the latest of these.
        located: robots that were, at any time.
    """

    poses: list[tuple[float, RobotPose]] = field(default_factory=list)
    verdicts: Counter[str] = field(default_factory=Counter)
    state: FleetState | None = None
    located: set[str] = field(default_factory=set)

    def note(self, at_s: float, key: str, message: Message) -> None:
        match message:
            case RobotPose():
                self.poses.append((at_s, message))
            case Alignment():
                self.verdicts[message.verdict] += 1
            case FleetState():
                here = located_in(message)
                self.located |= here
                if self.state is None or len(here) >= len(located_in(self.state)):
                    self.state = message
            case _:
                pass

    @property
    def last(self) -> dict[ViewName, RobotPose]:
        """The last pose of each view."""
        return {pose.view: pose for _, pose in self.poses}


def located_in(state: FleetState) -> set[str]:
    """Robots that are located."""
    return {one.robot for one in state.robots if one.pose is not None and one.pose.located}


def run(
    file: Path, out: Path, workers: int | None = None, job_ms: float | None = None
) -> dict[str, Any]:
    """Replays a recording in a process of its own; returns the summary.

    Raises:
        FleetPoseError: the recording cannot be read, or is of no site.
    """
    output_folder(out)
    with _repeatable() as process:
        return process.submit(replay, file, out, workers, job_ms).result()


@contextmanager
def _repeatable() -> Iterator[ProcessPoolExecutor]:
    """A process in which sets of names are walked through in the same order every time, and sums
    are added up by one thread.
    """
    from fleetpose.evaluation.bench.working import worker_pool

    wanted = {"PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        with worker_pool(1) as process:
            yield process
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def replay(
    file: Path,
    out: Path,
    workers: int | None = None,
    job_ms: float | None = None,
    align: Aligner = run_job,
) -> dict[str, Any]:
    """Replays a recording, and writes poses.csv, a TUM file for each robot and summary.json."""
    recording = site_recording(file)
    recorded = Recorded.of(recording)
    worked = replace(
        recorded, workers=workers or recorded.workers, job_ms=job_ms or recorded.job_ms
    )
    told = Told()
    logging.getLogger("pose_server").setLevel(logging.ERROR)  # alarms are in the summary
    server = ReplayServer(Keys(recording.site), worked, told.note, align)
    with progress_bar() as bar:
        task = bar.add_task("replay, seconds", total=round(recording.seconds))
        for record in heard(recording, Keys(recording.site)):
            server.hear(record)
            bar.update(task, completed=round(record.at_s))
        server.come_to(recording.seconds)
        server.end()
    summary = _summary(recording, worked, server, told)
    _write_poses(out, told)
    write_summary(out, summary)
    return summary


def _summary(
    recording: Recording, recorded: Recorded, server: ReplayServer, told: Told
) -> dict[str, Any]:
    site, state = server.site, told.state
    robots = () if state is None else state.robots
    return {
        "site": recording.site,
        "seconds": recording.seconds,
        "cut_off": recording.cut_off,
        "workers": recorded.workers,
        "job_ms": recorded.job_ms,
        "views": site.counts.get("views", 0),
        "jobs": dict(sorted(server.jobs.items())),
        "verdicts": dict(sorted(told.verdicts.items())),
        "solves": site.counts.get("solves", 0),
        "anchor": site.anchor,
        "robots": len(robots),
        "located": sorted(told.located),
        "located_at_once": 0 if state is None else len(located_in(state)),
        "why_not": {one.robot: one.why_not for one in robots if one.robot not in told.located},
        "alarms": [] if state is None else [one.text for one in state.alarms],
        "correspondences": len(site.correspondences.all()),
        "wide_keypoints_missing": server.unanswered,
        "drops": dict(sorted(server.drops.snapshot().items())),
        "undecodable": recorded.undecodable,
        "server_lives": len(recorded.servers),
        "poses": len(told.poses),
        "recorded_poses": len(recorded.poses),
        "beside_the_recording": asdict(agreement(recorded.poses, told.last)),
    }


def _write_poses(out: Path, told: Told) -> None:
    """All poses that were told as a table, and of each robot the last of each view in TUM's
    format: time tx ty tz qx qy qz qw, by the robot's clock.
    """
    rows = (
        {
            **pose.model_dump(include=set(COLUMNS)),
            **pose_cells(pose.T_fleet_robot, pose.covariance),
            "at_s": at_s,
            "epoch": pose.view.epoch,
            "seq": pose.view.seq,
        }
        for at_s, pose in told.poses
    )
    write_csv(out / "poses.csv", COLUMNS, rows)
    lines: dict[str, list[tuple[int, str]]] = {}
    for pose in told.last.values():
        w, x, y, z = quat_wxyz(pose.T_fleet_robot[:3, :3])
        place = " ".join(f"{value:.9f}" for value in (*pose.T_fleet_robot[:3, 3], x, y, z, w))
        line = f"{1e-9 * pose.stamp_ns:.6f} {place}\n"
        lines.setdefault(pose.robot, []).append((pose.stamp_ns, line))
    for robot, of_robot in lines.items():
        (out / f"{robot}.tum").write_text("".join(line for _, line in sorted(of_robot)))


def sentence(summary: dict[str, Any]) -> str:
    """What came out, for who replays."""
    beside = summary["beside_the_recording"]
    head = (
        f"{len(summary['located'])} of {summary['robots']} robots located, {summary['views']} "
        f"views, {sum(summary['jobs'].values())} jobs"
    )
    if beside["common"] == 0:
        return f"{head}; no pose that the recording locates as well to compare with"
    return (
        f"{head}; {beside['common']} poses are in the recording too: they differ by "
        f"{beside['median_m']:.4f} m, {beside['median_deg']:.3f} deg (median), "
        f"{beside['max_m']:.4f} m, {beside['max_deg']:.3f} deg (most); "
        f"{beside['only_recorded']} are located there alone, {beside['only_replayed']} here alone"
    )
