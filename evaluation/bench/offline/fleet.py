"""What a worker does for one drawn fleet: let a server put it together, beside the truth."""

import hashlib
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetpose.evaluation.bench.offline.server import OfflineServer
from fleetpose.evaluation.data.covisibility import Sights
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.data.recording import CloudKind, Recording, TrueView, are_partners
from fleetpose.evaluation.metrics.fleet_scoring import PoseNow, SampleRow, is_grave, score_sample
from fleetpose.evaluation.metrics.geometry import inverse
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.protocol.errors import DataFolderError

if TYPE_CHECKING:
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult
    from fleetpose.pose_server.workers.jobs import Job

ROBOTS = (4, 12)
MOST_JOBS_PER_PAIR = 6
"""A pair of still views has work for two or three jobs; who wants more goes round in circles."""


@dataclass(frozen=True)
class Task:
    """One fleet of a recording.

    Attributes:
        recording: where the views come from.
        wires: what the robots sent, by index of the view.
        seed: of the draw.
        views: indices, one for each robot.
        limits: what counts as grave there.
    """

    recording: Recording
    wires: dict[int, Path]
    seed: int
    views: tuple[int, ...]
    limits: Limits

    def views_of(self, server: OfflineServer) -> dict[str, TrueView]:
        """The true views of the robots, by name."""
        return {name: self.recording.view(index) for name, index in server.views.items()}


@dataclass(frozen=True)
class Placed:
    """What became of one robot.

    Attributes:
        seed: of its fleet.
        view: its index.
        together: its view and another robot's show the same.
        in_reach: a chain of common sights joins it to the anchor, and it is not alone.
        position_error_m, rotation_error_deg: the anchor as gauge; none where nothing joins them.
        grave: located, and gravely off.
        why_not: what the server says to why it is not located.
    """

    seed: int
    view: int
    anchor: bool
    together: bool
    in_reach: bool
    located: bool
    position_error_m: float | None
    rotation_error_deg: float | None
    verdict: str
    grave: bool
    why_not: str


@dataclass(frozen=True)
class Fleet:
    """A fleet that was put together as far as the server could.

    Attributes:
        robots: one for each view.
        explained: of each link that the fleet rests on, the share of what should be seen from there
            that is found again; empty where the server does not tell.
        components: into which it falls.
        finished: nothing was left to align.
    """

    robots: tuple[Placed, ...]
    explained: tuple[float, ...]
    components: int
    finished: bool


def draw_views(recording: Recording, robots: int | None, seed: int) -> tuple[int, ...]:
    """Views anywhere on the recording, no two of them stereo partners; 4 to 12 if not told.

    Raises:
        DataFolderError: there are not as many.
    """
    rng = np.random.default_rng(seed)
    usable = recording.usable
    most = min(ROBOTS[1], len(usable))
    wanted = robots or int(rng.integers(min(ROBOTS[0], most), most + 1))
    chosen: list[TrueView] = []
    for k in rng.permutation(len(usable)):
        if len(chosen) < wanted and not any(are_partners(usable[k], one) for one in chosen):
            chosen.append(usable[k])
    if len(chosen) < (robots or 2):
        raise DataFolderError(
            f"{recording.directory} has {len(chosen)} views for {robots or 2} robots"
        )
    return tuple(view.index for view in chosen)


def play(task: Task) -> Fleet:
    """Runs a fleet until nothing is left to align, and scores it."""
    server, finished = put_together(task)
    views = task.views_of(server)
    groups = _sights(task.recording.directory, task.recording.clouds).groups(views.values())
    group_of = {index: group for group in groups for index in group}
    rows = scored(server, views, task.limits)
    anchor = [server.views[row.robot] for row in rows if row.is_anchor]
    reached = max(groups, key=len) if not anchor else group_of[anchor[0]]
    why_not = {row.robot: server.why_not(row.robot) for row in rows}
    verdicts = {name: pose.verdict for name, pose in server.poses().items()}
    robots = tuple(
        Placed(
            seed=task.seed,
            view=server.views[row.robot],
            anchor=row.is_anchor,
            together=len(group_of[server.views[row.robot]]) > 1,
            in_reach=server.views[row.robot] in reached and len(reached) > 1,
            located=row.located,
            position_error_m=row.position_error_m,
            rotation_error_deg=row.rotation_error_deg,
            verdict=verdicts.get(row.robot, ""),
            grave=is_grave(row, task.limits),
            why_not=why_not[row.robot],
        )
        for row in rows
    )
    return Fleet(robots, _explained(server), len(server.components), finished)


def scored(server: OfflineServer, views: Mapping[str, TrueView], limits: Limits) -> list[SampleRow]:
    """Every robot's published pose beside the truth, the anchor as gauge, as in live runs."""
    poses = {
        name: PoseNow(
            pose.T_fleet_robot,
            pose.covariance,
            pose.component,
            pose.located,
            views[name].T_world_camera @ inverse(server.kept(name).camera.T_robot_camera),
            pose.verdict == "verified",
        )
        for name, pose in server.poses().items()
    }
    return score_sample(0.0, list(views), poses, server.site.anchor, limits.reference_sigma_m)


def put_together(task: Task) -> tuple[OfflineServer, bool]:
    """The server of a task's fleet when nothing is left to align; whether that came to pass."""
    wires = {index: task.wires[index] for index in task.views}
    server = OfflineServer(wires, remembering(next(iter(wires.values())).parent))
    return server, server.settle(MOST_JOBS_PER_PAIR * max(len(wires) * (len(wires) - 1) // 2, 1))


def _explained(server: OfflineServer) -> tuple[float, ...]:
    """Of the pairs whose views a link joins that the solution uses."""
    site = server.site
    assert site.solution is not None
    links = {frozenset((edge.a, edge.b)) for edge in site.edges.values()}
    results = [
        record.best
        for record in site.pairs.values()
        if record.best_views is not None and frozenset(record.best_views) in links
    ]
    shares = [explained_of(result) for result in results if result is not None]
    return tuple(share for share in shares if share is not None)


def explained_of(result: "PairResult") -> float | None:
    """The explained share of an alignment; none where it has no evidence."""
    return None if result.evidence is None else result.evidence.explained.share


def remembering(folder: Path) -> Callable[["Job"], "PairResult"]:
    """Does jobs, each only once for all workers: draws of one recording share most of their pairs.

    A job is known by everything in it; its views' bytes by their names.
    """

    def align(job: "Job") -> "PairResult":
        file = folder / f"{_key(job)}.result"
        if not file.exists():
            from fleetpose.pose_server.workers.run import run_job

            mine = file.with_suffix(f".{np.random.default_rng().integers(2**60)}")
            mine.write_bytes(pickle.dumps(run_job(job)))
            mine.replace(file)
        return pickle.loads(file.read_bytes())

    return align


def _key(job: "Job") -> str:
    i, j = (replace(view, payload=b"", wide=b"" if view.wide else None) for view in (job.i, job.j))
    return hashlib.sha256(pickle.dumps(replace(job, i=i, j=j))).hexdigest()


@lru_cache(maxsize=1)
def _sights(directory: Path, clouds: CloudKind | None) -> Sights:
    """Those of the recording that this worker serves."""
    return Sights(open_recording(directory, clouds))
