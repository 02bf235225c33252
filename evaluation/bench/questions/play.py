"""What the workers do for one seed: draw a fleet, and let every policy ask until all robots are
located, and rightly.
"""

import pickle
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.bench.clicks.worker import kept, sizes_of, with_wide
from fleetpose.evaluation.bench.questions.policies import POLICIES
from fleetpose.evaluation.bench.questions.server import FleetServer, RobotPair, named_pairs
from fleetpose.evaluation.bench.ring.solving import connected
from fleetpose.evaluation.data.opening import points_of
from fleetpose.evaluation.data.recording import Recording, TrueView, are_partners
from fleetpose.evaluation.metrics.geometry import Floats, inverse, transform
from fleetpose.evaluation.metrics.scoring import Limits, pose_errors
from fleetpose.evaluation.simulate.mistakes import Sight, mistaken, sight_of
from fleetpose.evaluation.simulate.operator import PICKS_LOOKED_AT, by_hand, far_apart
from fleetpose.pose_server.questions.facts import questions
from fleetpose.protocol import codec
from fleetpose.protocol.messages import View

if TYPE_CHECKING:
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult

ROBOTS = (8, 12)
ENOUGH_SHARED = 10  # points that both views see: a fair operator finds three of them
CLICKS, CLICKS_FOR_NOTHING = 3, 2
MOST_PER_ROBOT = 10
TRUE_PX = 3.0
_DRAWS = 200
_SMALLEST = 3
_SAME_PX = 1.5  # a pixel and a recorded point's


@dataclass(frozen=True)
class Task:
    """One seed of a recording; `wires` is what the robots of all views sent, by index, `limits` say
    what is grave there, `mistakes` the share of the questions that the operator answers wrongly.
    """

    recording: Recording
    wires: dict[int, Path]
    seed: int
    limits: Limits
    mistakes: float = 0.0


@dataclass
class Run:
    """One fleet, asked about by one policy.

    Attributes:
        components: that the automatic path leaves.
        minimum: clicks that join them if each pair asked for works at once.
        clicks: until all robots were located and none of them gravely off; the most allowed where
            that never came to pass.
        located: it did.
        asked: pairs, in their order, as indices of the views.
        in_vain: how many of these had too few points in common.
        grave: a robot is located and gravely off when there is nothing more to ask, or no click
            left.
        grave_verified: and its pose is called verified.
        claimed: at some time all robots claimed to be located, and one of them was gravely off: an
            operator who cannot know that would have stopped there.
    """

    seed: int
    policy: str
    robots: int
    components: int
    minimum: int
    clicks: int = 0
    located: bool = False
    asked: list[tuple[int, int]] = field(default_factory=list)
    in_vain: int = 0
    grave: bool = False
    grave_verified: bool = False
    claimed: bool = False


@dataclass
class Played:
    """All policies on one fleet; of the points suggested with the first questions that could be
    judged, the rank of their question and whether they are true.
    """

    runs: list[Run]
    suggestions: list[tuple[int, bool]] = field(default_factory=list)


def play(task: Task) -> Played | None:
    """Draws the seed's fleet and plays all policies; none if there is no such fleet."""
    drawn = draw_fleet(task)
    if drawn is None:
        return None
    played = Played([])
    for policy in POLICIES:
        server = server_of(task, drawn)
        if not played.runs:
            played.suggestions = judged_suggestions(task, server)
        played.runs.append(asked(task, server, policy))
    return played


def draw_fleet(task: Task) -> tuple[int, ...] | None:
    """Views of 8 to 12 robots anywhere on the recording, no two of them stereo partners.

    Only fleets count that need the operator and that an operator can help: the automatic path
    leaves several components or puts a robot gravely wrong, and pairs of views with ten points in
    common connect what is right. Where the views are so near to each other that no draw falls
    apart, fewer robots are drawn.
    """
    rng = np.random.default_rng(task.seed)
    usable = [view for view in task.recording.usable if view.index in task.wires]
    low, high = (min(n, len(usable)) for n in ROBOTS)
    for number in range(_DRAWS):
        fewer = number // 20  # the first twenty draws are as asked for
        count = max(int(rng.integers(low, high + 1)) - fewer, _SMALLEST)
        chosen = [usable[k] for k in rng.choice(len(usable), min(count, len(usable)), False)]
        views: list[TrueView] = []
        for view in chosen:
            if not any(are_partners(view, other) for other in views):
                views.append(view)
        indices = tuple(view.index for view in views)
        parts = _parts(task, server_of(task, indices))
        if len(parts) > 1 and _can_be_joined(task, views, parts):
            return indices
    return None


def server_of(task: Task, views: Sequence[int]) -> FleetServer:
    """The drawn fleet, after all pairs were aligned automatically."""
    wires = {index: task.wires[index] for index in views}
    names = {kept(wire).name.robot: wire for wire in wires.values()}
    results = {(a, b): aligned(names[a], names[b]) for a, b in named_pairs(list(names))}
    return FleetServer(wires, results)


def aligned(wire_i: Path, wire_j: Path) -> "PairResult":
    """The automatic alignment of two views as the server does it; every pair once for all
    workers.
    """
    file = wire_i.parent / f"{wire_i.stem}-{wire_j.stem}.aligned"
    if file.exists():
        return pickle.loads(file.read_bytes())
    from fleetpose.pose_server.registration.align import is_settled
    from fleetpose.pose_server.workers.jobs import PairJob, RetryJob
    from fleetpose.pose_server.workers.run import run_job

    i, j = kept(wire_i).encoded, kept(wire_j).encoded
    result = run_job(PairJob(i, j))
    if not is_settled(result):
        result = run_job(RetryJob(with_wide(i, wire_i), with_wide(j, wire_j), before=result))
    mine = file.with_suffix(f".{np.random.default_rng().integers(2**60)}")
    mine.write_bytes(pickle.dumps(result))
    mine.replace(file)
    return result


def _parts(task: Task, server: FleetServer) -> list[set[str]]:
    """What is joined, each robot that is joined gravely wrong by itself."""
    grave = set(_gravely_off(task, server))
    parts = [names - grave for names in server.components]
    return [names for names in parts if names] + [{name} for name in sorted(grave)]


def _can_be_joined(task: Task, views: Sequence[TrueView], parts: Sequence[set[str]]) -> bool:
    number = {kept(task.wires[view.index]).name.robot: view.index for view in views}
    of = {number[name]: k for k, names in enumerate(parts) for name in names}
    links = [
        (of[i.index], of[j.index])
        for i, j in combinations(views, 2)
        if of[i.index] != of[j.index] and len(true_pixels(task.recording, i, j)[0]) >= ENOUGH_SHARED
    ]
    joined = connected([*links, *((k, k) for k in range(len(parts)))])
    return len(joined) == 1


def asked(task: Task, server: FleetServer, policy: str) -> Run:
    """Asks by a policy until all are located and right, or there were ten clicks per robot."""
    components = len(server.components)
    least = CLICKS * max(components - 1, 1)  # a fleet that is joined wrongly needs a pair as well
    run = Run(task.seed, policy, len(server.views), components, least)
    most = MOST_PER_ROBOT * run.robots
    visits: Counter[RobotPair] = Counter()
    rng = np.random.default_rng((task.seed, 1))
    while not _settled(task, server, run) and run.clicks < most:
        pair = POLICIES[policy](server, visits, rng)
        if pair is None:
            break
        views = (server.views[pair[0]], server.views[pair[1]])
        clicks = clicks_in(task, views, visits[pair])
        visits[pair] += 1
        run.asked.append(views)
        server.visit(pair, clicks)
        if clicks:
            run.clicks += CLICKS
        else:
            run.clicks += CLICKS_FOR_NOTHING
            run.in_vain += 1
    grave = _gravely_off(task, server)
    run.grave, run.grave_verified = bool(grave), any(map(server.is_verified, grave))
    run.clicks = min(run.clicks, most) if run.located else most
    return run


def _settled(task: Task, server: FleetServer, run: Run) -> bool:
    """Whether all robots are located and right; notes it, and if they only claim to be."""
    everybody = len(server.located_cameras()) == len(server.views)
    wrong = everybody and bool(_gravely_off(task, server))
    run.located = everybody and not wrong
    run.claimed = run.claimed or wrong
    return run.located


def _gravely_off(task: Task, server: FleetServer) -> list[str]:
    """Located robots that are gravely off, the anchor as gauge."""
    placed = server.located_cameras()
    anchor = server.site.anchor
    if anchor is None or anchor not in placed:
        return []
    views = {name: task.recording.view(server.views[name]) for name in placed}
    grave = []
    for name, T_fleet_camera in placed.items():
        T = inverse(placed[anchor]) @ T_fleet_camera
        if task.limits.grave(*pose_errors(views[anchor].T_to(views[name]), T)):
            grave.append(name)
    return grave


def clicks_in(task: Task, views: tuple[int, int], visit: int) -> list[tuple[Floats, Floats]]:
    """Three correspondences as clicked on a visit to two views, other ones on each; none where
    there are not enough. They are the same whoever asks. Nobody tells the operator beforehand
    where the server has a depth, and some questions are answered wrongly.
    """
    i, j = views
    seen = (kept(task.wires[i]), kept(task.wires[j]))
    rng = np.random.default_rng((task.seed, *sorted(views)))
    true = true_pixels(task.recording, task.recording.view(i), task.recording.view(j))
    wanted = CLICKS * (visit + 1)
    if len(true[0]) < wanted:
        return []
    order = far_apart(true[0], wanted + PICKS_LOOKED_AT, rng)[wanted - CLICKS :]
    picks = (true[0][order], true[1][order])
    chance = np.random.default_rng((task.seed, visit, *sorted(views)))
    spoilt = None
    if chance.uniform() < task.mistakes:
        spoilt = mistaken(picks, _sight(task.wires[j]), CLICKS, chance)
    pixels = (picks[0][:CLICKS], picks[1][:CLICKS]) if spoilt is None else spoilt.pixels
    clicks = by_hand(pixels, rng, sizes_of(seen))
    return [(click.pixel_i, click.pixel_j) for click in clicks]


@lru_cache(maxsize=64)
def _sight(wire: Path) -> Sight:
    return sight_of(codec.unpack(View, wire.read_bytes()))


def judged_suggestions(task: Task, server: FleetServer) -> list[tuple[int, bool]]:
    """Of the points that come with the first questions those that show a place whose depth is
    recorded: the rank of their question, and whether they are true to 3 px.
    """
    judged = []
    for rank, question in enumerate(questions(server.site)):
        i, j = (
            task.recording.view(server.views[name.robot])
            for name in (question.view_i, question.view_j)
        )
        T_j_i = j.T_to(i)
        for one in question.suggestions:
            place = _true_place(task.recording, i, one.pixel_i)
            if place is None:
                continue
            u, v, w = j.K @ transform(T_j_i, place[None])[0]
            off_px = np.hypot(u / w - one.pixel_j[0], v / w - one.pixel_j[1])
            judged.append((rank, bool(w > 0 and off_px < TRUE_PX)))
    return judged


def _true_place(recording: Recording, view: TrueView, pixel: Floats) -> Floats | None:
    """(3,) the recorded point at a pixel, without the noise of the view's own cloud where there are
    points of several views.
    """
    sparse = recording.directory / "sparse" / Path(view.name).with_suffix(".npz").name
    uv, points = _recorded_points(sparse if sparse.exists() else view.cloud, view)
    nearest = int(np.linalg.norm(uv - pixel, axis=1).argmin())
    return points[nearest] if np.linalg.norm(uv[nearest] - pixel) < _SAME_PX else None


_recorded: dict[Path | None, tuple[Floats, Floats]] = {}  # a worker serves one recording


def _recorded_points(cloud: Path | None, view: TrueView) -> tuple[Floats, Floats]:
    if cloud not in _recorded:
        _recorded[cloud] = points_of(replace(view, cloud=cloud))
    return _recorded[cloud]
