"""`pose-eval bench`: a published benchmark, played by its sequences as robots."""

import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.published.bag_layouts import BAG_LAYOUTS, open_bags, truth_told
from fleetpose.evaluation.bench.published.layouts import LAYOUTS, open_sequence
from fleetpose.evaluation.bench.published.papers import REPORTED
from fleetpose.evaluation.bench.published.play import Estimate, Played, play
from fleetpose.evaluation.bench.published.sequences import RecordedSequence
from fleetpose.evaluation.metrics.trajectory_error import Positions, trajectory_error
from fleetpose.evaluation.options.published import BenchOptions
from fleetpose.evaluation.report.output import output_folder, print_table, scalars, write_summary
from fleetpose.formats.tum import write_tum
from fleetpose.protocol.errors import DataFolderError


def run(options: BenchOptions, out: Path) -> dict[str, Any]:
    """Plays the sequences, scores the fleet, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used.
    """
    robots = robots_of(options)
    output_folder(out)
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        played = play(robots, Path(scratch))
    summary = summary_of(options, robots, played)
    write_trajectories(robots, played, out / "tum")
    write_summary(out, summary)
    _print(options, summary)
    return summary


def robots_of(options: BenchOptions) -> list[RecordedSequence]:
    """The sequences that robots walk along.

    Raises:
        DataFolderError: the layout is not known, or the data is not laid out so.
    """
    known = {**LAYOUTS, **BAG_LAYOUTS}
    if options.layout not in known:
        raise DataFolderError(f"--layout {options.layout}: known are {', '.join(known)}")
    names = [name for name in options.robots.split(",") if name] or [""]
    step = options.every or known[options.layout].every
    robots: list[RecordedSequence] = []
    for name in names:
        sequence = _opened(options, name).every(step, options.frames)
        robots += (
            sequence.split(options.split, options.in_turn) if options.split > 1 else [sequence]
        )
    if len({robot.name for robot in robots}) < len(robots) or not robots:
        raise DataFolderError(f"--robots {options.robots}: name sequences, each once")
    return robots


def _opened(options: BenchOptions, name: str) -> RecordedSequence:
    if options.layout not in BAG_LAYOUTS:
        return open_sequence(options.layout, options.data, name)
    if not name:
        raise DataFolderError(f"--layout {options.layout}: name its robots with --robots")
    how = (options.stamps, options.calibration)
    return open_bags(options.layout, options.data, name, *how)


def positions_of(robots: Sequence[RecordedSequence], played: Played) -> dict[str, Positions]:
    """True and estimated positions of the robots in the fleet's own frame."""
    return _positions(robots, [one for one in played.estimates if one.component == played.anchors])


def own_positions_of(robots: Sequence[RecordedSequence], played: Played) -> dict[str, Positions]:
    """The same of each robot alone, in the component where most of its frames are: one that nobody
    met has a trajectory, too.
    """
    count = Counter((one.robot, one.component) for one in played.estimates)
    most = {robot: component for (robot, component), _ in reversed(count.most_common())}
    return _positions(robots, [one for one in played.estimates if one.component == most[one.robot]])


def _positions(
    robots: Sequence[RecordedSequence], estimates: Sequence[Estimate]
) -> dict[str, Positions]:
    shots = {robot.name: robot.shots for robot in robots}
    found: dict[str, tuple[list[Any], list[Any]]] = {}
    for one in estimates:
        true = shots[one.robot][one.shot].T_world_camera
        if true is not None:
            both = found.setdefault(one.robot, ([], []))
            both[0].append(true[:3, 3])
            both[1].append(one.T_fleet_camera[:3, 3])
    return {robot: (np.array(true), np.array(est)) for robot, (true, est) in found.items()}


def summary_of(
    options: BenchOptions, robots: Sequence[RecordedSequence], played: Played
) -> dict[str, Any]:
    """What `summary.json` holds."""
    positions = positions_of(robots, played)
    error = trajectory_error(positions)
    own = own_positions_of(robots, played)
    own_error = trajectory_error(own)
    frames = sum(len(robot.shots) for robot in robots)
    return {
        "layout": options.layout,
        "robots": len(robots),
        "robots_joined": len(positions),
        "frames": frames,
        "frames_placed": sum(len(true) for true, _ in positions.values()),
        "frames_refused": played.refused,
        "lost": sum(played.lost.values()),
        "lost_robots": played.lost,
        "keyframes": played.keyframes,
        "alignments": played.jobs,
        "ate_joint_m": error.joint_m,
        "ate_robots_mean_m": own_error.robots_mean_m,
        "ate_robots_m": own_error.robots_m,
        "frames_of_robots": {name: len(true) for name, (true, _) in own.items()},
        "truth": truth_told(options.layout) or "of the camera",
        "published": [vars(one) for one in REPORTED[options.layout]],
    }


def write_trajectories(robots: Sequence[RecordedSequence], played: Played, folder: Path) -> None:
    """Estimates and truth of each robot, for `evo_ape tum TRUTH ESTIMATE -a`."""
    shots = {robot.name: robot.shots for robot in robots}
    folder.mkdir(parents=True, exist_ok=True)
    for name, own in shots.items():
        there = [
            one
            for one in played.estimates
            if one.robot == name
            and one.component == played.anchors
            and own[one.shot].T_world_camera is not None
        ]
        stamps_ns = np.array([own[one.shot].stamp_ns for one in there], np.int64)
        poses = np.array([one.T_fleet_camera for one in there]).reshape(-1, 4, 4)
        truth = np.array([own[one.shot].T_world_camera for one in there]).reshape(-1, 4, 4)
        write_tum(folder / f"{name}.tum", stamps_ns, poses)
        write_tum(folder / f"{name}_truth.tum", stamps_ns, truth)


def _print(options: BenchOptions, summary: dict[str, Any]) -> None:
    rows = [*scalars(summary)]
    rows += [(f"ate of {name}", value) for name, value in summary["ate_robots_m"].items()]
    print_table(f"{options.layout}: {options.robots}", ("", ""), rows)
    if summary["published"]:
        columns = ("sequences", "method", "ate_m", "sensor", "source")
        print_table(
            "what others report (*: second-hand, check it before you quote it)",
            columns,
            [
                (*(one[name] for name in columns[:-1]), one["source"] + " *" * one["second_hand"])
                for one in summary["published"]
            ],
        )
    else:
        print("no figures of fleets on this data set are known")
