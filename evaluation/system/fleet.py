"""`pose-eval fleet`: live processes on a recording or in the synthetic world, against the truth."""

import random
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.data.anonymize import distinct_names, strip
from fleetpose.evaluation.data.covisibility import paired_up
from fleetpose.evaluation.data.parts import parts_of
from fleetpose.evaluation.metrics.fleet_scoring import PoseNow, SampleRow, score_sample
from fleetpose.evaluation.metrics.scoring import RGBD_REFERENCE_SIGMA_M
from fleetpose.evaluation.options.fleets import FleetOptions
from fleetpose.evaluation.report.output import output_folder, progress_bar
from fleetpose.evaluation.simulate.operator import SimulatedOperator
from fleetpose.evaluation.system.fleet_report import FleetResult, write_results
from fleetpose.evaluation.system.memory import Memory
from fleetpose.evaluation.system.observer import Believed, Observer
from fleetpose.evaluation.system.truth import RecordedTruth, Truth, WorldTruth
from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import Link, SessionSettings, free_port, open_session, wait_until

USUAL_ROBOTS = 6
FIRST_SAMPLE_S = 20.0
WORLD_START_S = 60.0
RATE_HZ, REPLAYED_RATE_HZ = 1.0, 0.5  # views of an agent, and of each robot that is replayed
MOST_AGENTS = 16
"""Beyond, views are encoded beforehand and replayed, so that the server is measured."""
LOAD = "load"
ERRAND_RATE = 30.0  # clicks per minute on pairs that are skipped otherwise
STARTED_WITHIN_S = 120.0


@dataclass(frozen=True)
class RobotPlan:
    """How one robot is started."""

    name: str
    camera: str
    data: str
    options: tuple[str, ...] = ()
    rate_hz: float = 1.0


@dataclass(frozen=True)
class FleetPlan:
    """Which robots run, in the order r1, r2, ... of the recording, and what is true of them."""

    robots: tuple[RobotPlan, ...]
    truth: Truth
    world: tuple[str, ...] = ()  # arguments of the world's process, if there is one
    frames: int = 1  # of each robot, where they are replayed by one process

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(robot.name for robot in self.robots)

    @property
    def replayed(self) -> bool:
        """Whether one process replays views that were encoded beforehand, for all robots."""
        return len(self.robots) > MOST_AGENTS

    @property
    def agents(self) -> tuple[str, ...]:
        """The names of the processes that are the robots."""
        return (LOAD,) if self.replayed else self.names


@dataclass
class _Watch:
    """What is noted while the fleet runs."""

    rows: list[SampleRow] = field(default_factory=list)
    memory: Memory = field(default_factory=Memory)


def run(options: FleetOptions, out: Path) -> dict[str, Any]:
    """Runs a fleet, scores its published poses every second from 20 s on; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or a process ended.
    """
    if options.seconds <= FIRST_SAMPLE_S:
        seconds = f"--seconds {options.seconds:g}"
        raise FleetPoseError(f"{seconds}: poses are scored from 20 s on, give more")
    options.in_metres()  # what cannot be is said before anything is made
    for old in output_folder(out).glob("logs/*.log"):
        old.unlink()
    watch = _Watch()
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        plan = plan_fleet(options, Path(scratch))
        skip = named_skip_pairs(options.skip_pairs, plan.names, Path(scratch))
        with LocalFleet(out / "logs") as fleet:
            state = Path(scratch) / "state"
            cluster = () if options.cluster is None else ("--cluster", options.cluster)
            of_server = ("--recipe", options.recipe, *cluster)
            start(fleet, plan, options.workers, state, skip, of_server)
            with observed(fleet) as observer, ExitStack() as closing:
                started_s = wait_started(fleet, observer, len(plan.robots))
                operator = _operator(options, observer, plan, skip)
                if operator is not None:
                    closing.callback(operator.close)
                    operator.start()
                _watch(fleet, observer, plan, started_s, options.seconds, watch)
                if operator is not None:
                    operator.finish()
                unanswered_s = [] if operator is None else operator.unanswered_s()
        result = FleetResult(
            robots=plan.names,
            rows=watch.rows,
            observer=observer,
            operator=operator,
            unanswered_s=unanswered_s,
            memory=watch.memory,
            started_s=started_s,
            median_depth_m=plan.truth.median_depth_m(observer.newest_views()),
            rgbd=plan.truth.rgbd,
            together=_seen_together(observer, plan.truth),
            leftover_processes=fleet.leftover_processes(),
        )
    return write_results(out, result)


def _operator(
    options: FleetOptions, observer: Observer, plan: FleetPlan, skip: Path | None
) -> SimulatedOperator | None:
    """Who clicks at a steady rate, or so many points on each skipped pair and no more."""
    if options.clicks_on_skipped and skip is not None:
        pairs = [tuple(sorted(line.split())) for line in skip.read_text().splitlines()]
        errands = dict.fromkeys(pairs, options.clicks_on_skipped)
        return SimulatedOperator(observer, plan.truth, ERRAND_RATE, errands=errands)
    if options.clicks_per_minute > 0:
        rate, seed = options.clicks_per_minute, options.seed
        return SimulatedOperator(observer, plan.truth, rate, seed=seed, mistakes=options.mistakes)
    return None


def plan_fleet(options: FleetOptions, scratch: Path) -> FleetPlan:
    """Robots with random names on stripped folders of a recording, or in a synthetic world."""
    rng = random.Random()
    robots = options.robots or USUAL_ROBOTS
    names = distinct_names(len(options.views) or robots, rng)
    if options.world is not None and options.data:
        raise FleetPoseError(f"--world {options.world} and --data: give one of them")
    recording = options.recording()
    if recording is None:
        if options.views:
            raise DataFolderError("--views names views of a recording: give --data DIR")
        world = (options.seed, options.world, options.unique)
        return plan_world(names, scratch, options.moving, *world)
    parts = parts_of(recording, robots, options.first, options.views)
    folders = {
        name: strip(recording, part, scratch / name, rng)
        for name, part in zip(names, parts, strict=True)
    }
    still = options.views or not recording.is_rgbd
    replay = ("--replay", "hold" if still else "pingpong")
    return FleetPlan(
        tuple(
            RobotPlan(name, folder.camera, str(folder.path), replay, RATE_HZ)
            for name, folder in folders.items()
        ),
        RecordedTruth(recording, folders),
        frames=max(len(part) for part in parts),
    )


def plan_world(
    names: Sequence[str],
    scratch: Path,
    moving: bool,
    seed: int,
    plan: str | None = None,
    unique: int = 0,
) -> FleetPlan:
    """Robots in a synthetic world, which runs in a process of its own.

    Args:
        names: of the robots.
        scratch: where the truth goes.
        moving: they walk.
        seed: of the world.
        plan: one that fools; else the town square.
        unique: how many unique things stand about in it.

    Raises:
        FleetPoseError: too many robots are to walk, or robots of a plan.
    """
    if moving and plan is not None:
        raise FleetPoseError(f"--moving --world {plan}: robots of a plan stand still")
    if unique and plan is None:
        raise FleetPoseError(f"--unique {unique}: name a plan with --world")
    if moving and len(names) > MOST_AGENTS:
        raise FleetPoseError(
            f"--moving --robots {len(names)}: beyond {MOST_AGENTS} robots replay what was encoded "
            "beforehand, so that they cannot walk through the world"
        )
    listen = f"127.0.0.1:{free_port()}"
    truth_file = scratch / "truth"
    world = ["world", "--robots", str(len(names)), "--listen", listen, "--seed", str(seed)]
    world += ["--truth-file", str(truth_file), *(["--moving"] if moving else [])]
    world += [] if plan is None else ["--plan", plan, "--unique", str(unique)]
    places = {name: f"r{number + 1}" for number, name in enumerate(names)}
    robots = tuple(
        RobotPlan(name, "synthetic", f"{listen}/{place}", rate_hz=RATE_HZ)
        for name, place in places.items()
    )
    return FleetPlan(robots, WorldTruth(truth_file, places), tuple(world))


def named_skip_pairs(path: Path | None, names: Sequence[str], scratch: Path) -> Path | None:
    """Writes lines `r1 r2` (places from 1 on) with the robots' random names instead.

    Raises:
        DataFolderError: the file cannot be read, or names no such robot.
    """
    if path is None:
        return None
    places = {f"r{number + 1}": name for number, name in enumerate(names)}
    try:
        pairs = [line.split() for line in path.read_text().splitlines() if line.strip()]
        lines = [f"{places[a]} {places[b]}" for a, b in pairs]
    except (OSError, KeyError, ValueError) as error:
        raise DataFolderError(
            f"--skip-pairs {path}: {error!r}; write lines like 'r1 r2', up to r{len(names)}"
        ) from error
    named = scratch / "skip_pairs"
    named.write_text("\n".join(lines) + "\n")
    return named


def kept_apart(names: Sequence[str], scratch: Path) -> Path:
    """Writes a file of pairs to skip: all of the last robot, so that only an operator can join
    it.
    """
    path = scratch / "kept_apart"
    path.write_text("".join(f"{name} {names[-1]}\n" for name in names[:-1]))
    return path


def start(
    fleet: LocalFleet,
    plan: FleetPlan,
    workers: int,
    state: Path,
    skip_pairs: Path | None = None,
    of_server: Sequence[str] = (),
) -> None:
    """Starts router, world, server, with options of its own, and robots."""
    start_servers(fleet, plan, workers, state, skip_pairs, of_server)
    if plan.replayed:
        replayed = replay_arguments(plan, REPLAYED_RATE_HZ, plan.frames)
        fleet.start(LOAD, "fleetpose.evaluation", "load", *fleet.connection, *replayed)
        return
    for robot in plan.robots:
        start_robot(fleet, robot)


def start_robot(fleet: LocalFleet, robot: RobotPlan) -> None:
    """Starts one robot's agent."""
    rate = ("--rate", str(robot.rate_hz))
    fleet.start_robot(robot.name, robot.camera, robot.data, *rate, *robot.options)


def start_servers(
    fleet: LocalFleet,
    plan: FleetPlan,
    workers: int,
    state: Path,
    skip_pairs: Path | None = None,
    of_server: Sequence[str] = (),
) -> None:
    """Starts router, world and server."""
    fleet.start_router()
    if plan.world:
        fleet.start("world", "fleetpose.evaluation", *plan.world)
    skip = () if skip_pairs is None else ("--skip-pairs", str(skip_pairs))
    fleet.start_server("--workers", str(workers), *skip, *of_server, state=state)
    if isinstance(plan.truth, WorldTruth):
        _wait_for_world(fleet, plan.truth)


def _wait_for_world(fleet: LocalFleet, truth: WorldTruth) -> None:
    """A world paints its textures first; robots are started when it listens.

    Raises:
        ProcessEndedError: it ended.
        FleetPoseError: it does not listen within a minute.
    """

    def ready() -> bool:
        fleet.check()
        return truth.is_there()

    if not wait_until(ready, WORLD_START_S, poll_s=0.1):
        raise FleetPoseError(f"the world does not start; its log ends:\n{fleet.tail('world')}")


def open_link(fleet: LocalFleet) -> Link:
    """The evaluation's own session."""
    return Link(open_session(SessionSettings(connect=(fleet.endpoint,))))


@contextmanager
def observed(fleet: LocalFleet) -> Iterator[Observer]:
    """What is heard of a fleet, by a session of the evaluation's own."""
    link = open_link(fleet)
    observer = Observer(link, Keys(fleet.site))
    try:
        yield observer
    finally:
        observer.close()
        link.close()


def wait_started(fleet: LocalFleet, observer: Observer, robots: int) -> float:
    """Waits until server and robots show themselves alive; returns the monotonic time.

    Raises:
        ProcessEndedError: one of them ended.
        FleetPoseError: they are not up within two minutes.
    """

    def up() -> bool:
        return observer.server_alive() and observer.alive_robots() == robots

    if not wait_running(fleet, up, STARTED_WITHIN_S):
        raise FleetPoseError(
            f"after {STARTED_WITHIN_S:.0f} s {observer.alive_robots()} of {robots} robots are up; "
            f"the logs are in {fleet.directory}"
        )
    return time.monotonic()


def poses_now(
    observer: Believed, truth: Truth, ahead_ns: Mapping[str, int] | None = None
) -> dict[str, PoseNow]:
    """The newest pose of each robot beside the truth; a stale pose is neither located nor verified.

    Args:
        ahead_ns: by how much clocks of robots are ahead; else they share this machine's clock.
    """
    poses = {}
    for robot, seen_pose in observer.poses().items():
        pose = seen_pose.pose
        seen = observer.view(pose.view)
        T_world_robot = None if seen is None else truth.T_world_robot(seen)
        now_ns = time.time_ns() + (ahead_ns or {}).get(robot, 0)
        if T_world_robot is not None:
            poses[robot] = PoseNow(
                pose.T_fleet_robot,
                pose.covariance,
                pose.component,
                pose.located and pose.valid_until_ns > now_ns,
                T_world_robot,
                pose.verdict == "verified" and pose.valid_until_ns > now_ns,
            )
    return poses


def _seen_together(observer: Observer, truth: Truth) -> set[str]:
    """Robots whose newest view shows what another one's shows as well."""
    seen = {view.view.name.robot: view for view in observer.newest_views()}
    return paired_up(list(seen), lambda a, b: truth.see_the_same(seen[a], seen[b]))


def _watch(
    fleet: LocalFleet,
    observer: Observer,
    plan: FleetPlan,
    started_s: float,
    seconds: float,
    watch: _Watch,
) -> None:
    with progress_bar() as progress:
        task = progress.add_task("seconds", total=int(seconds))
        for second in range(1, int(seconds) + 1):
            wait_until(lambda end=started_s + second: time.monotonic() >= end, 2.0)
            fleet.check()
            watch.memory.note(fleet, plan.agents)
            if second >= FIRST_SAMPLE_S:
                anchor = None if observer.state is None else observer.state.anchor
                now = poses_now(observer, plan.truth)
                noise_m = RGBD_REFERENCE_SIGMA_M if plan.truth.rgbd else 0.0
                watch.rows += score_sample(float(second), plan.names, now, anchor, noise_m)
            located = f"{observer.located_counts[-1][1]}/{len(plan.robots)} located"
            progress.update(task, completed=second, description=located)


def replay_arguments(plan: FleetPlan, rate_hz: float, frames: int) -> tuple[str, ...]:
    """The arguments of `pose-eval load` for the robots of a plan."""
    written = [f"{robot.name},{robot.camera},{robot.data}" for robot in plan.robots]
    robots = [part for one in written for part in ("--robot", one)]
    return (*robots, "--rate", str(rate_hz), "--frames", str(frames))
