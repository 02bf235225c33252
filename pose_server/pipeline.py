"""The two flows, free of I/O and clocks: what becomes of a view, and what becomes of a click.

A view: `receive_view` -> `next_job` (follow it on its robot's keyframes, then the most promising
pair) ~~ a worker aligns ~~ `take_result` -> `solve`. A click: `receive_update` (validated, lifted,
journalled) -> `urgent_job` ~~ a worker kept for it aligns ~~ `take_result` -> `solve`. The shell
publishes what changed.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from fleetpose.pose_server.calibration.monitor import note_depths, note_mirror
from fleetpose.pose_server.consistency.anchoring import choose_anchor, gauge_of
from fleetpose.pose_server.consistency.blindness import note_without_depth
from fleetpose.pose_server.consistency.doubts import reconsider
from fleetpose.pose_server.consistency.levelling import learns_up, level
from fleetpose.pose_server.consistency.repetition import believed, note_refuted, note_repetition
from fleetpose.pose_server.correspondences.on_keyframes import (
    click_factors,
    clicks_between,
    judge,
    note_heard,
)
from fleetpose.pose_server.correspondences.store import Outcome
from fleetpose.pose_server.frontend.frames import on_keyframes
from fleetpose.pose_server.frontend.localization import (
    back_job,
    followed,
    localize_past,
    newest_arrived,
    track_job,
)
from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose, accepted
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.types import GRAVE_BY_VERDICT, Edge, SolveSettings
from fleetpose.pose_server.questions.feedback import note_clicks, note_selection, note_solved
from fleetpose.pose_server.registration.operator_starts import FULL_POSE
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling import pair_queue
from fleetpose.pose_server.scheduling.affine_retries import note_open, wide_job
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView, NoDepthError
from fleetpose.pose_server.workers.jobs import ClickJob, Done, Job, PairJob, TrackJob
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import RobotPair, ordered_pair
from fleetpose.protocol.messages import Denials, OperatorUpdate, Selection, ViewName

_COVARIANCES_AT_ONCE = 24  # made anew in a solve
QUIET_S = 1.0  # after a click: until then the next one may come, which features must know of
_SHARES = {"track": 4.0, "pair": 4.0, "wide": 2.0, "search": 2.0}  # of work nobody looks at


def receive_view(site: Site, view: KeptView) -> None:
    """Takes a view of a live robot: keeps it, and follows it if it is the robot's newest.

    A view whose robot's token was not seen yet waits for it; one of a life that is over is refused.

    Raises:
        CodecError: another life of the robot is the live one.
    """
    robot = site.robots.get(view.name.robot)
    if robot is None or robot.epoch is None:
        site.hold_back(view)
        return
    if view.name.epoch != robot.epoch:
        raise CodecError(f"view of a life that is over: '{robot.name}' lives in {robot.epoch}")
    before = robot.newest
    site.views.keep(view)
    site.count("views")
    if before is None or before.epoch != view.name.epoch or before.seq < view.name.seq:
        site.note_change(robot, view)
        newest_arrived(site, robot, view)
        if learns_up(site, view):
            site.want_solution()


def refuse_view(site: Site, name: str, error: FleetPoseError) -> None:
    """A view of a robot cannot be used; why is told where its robot is asked about."""
    robot = site.robots.get(name)
    if robot is None:
        return
    robot.refuse(str(error))
    if isinstance(error, NoDepthError):
        note_without_depth(site, robot)


def receive_denials(site: Site, denials: Denials) -> None:
    """A router says what it denies; a name that is new in it is an event."""
    for news in site.denials.note(denials):
        site.say(news)


def receive_fetched(site: Site, view: KeptView) -> None:
    """Keeps a view that was asked of its robot because an operator looks at it."""
    if view.name not in site.views:
        site.views.keep(view)
        site.count("views_fetched")
    if view.name in site.held():
        localize_past(site, view.name)


def receive_token(site: Site, name: str, epoch: str, alive: bool) -> None:
    """A robot shows itself, or is gone; what came before its token is taken now.

    Raises:
        SiteFullError: there are too many robots.
    """
    if not alive and name not in site.robots:
        return
    robot = site.newcomer(name) if alive else site.robot(name)
    was = robot.epoch
    robot.note_token(epoch, alive)
    if robot.epoch is None and robot.newest is None and not site.has_of(name):
        site.forget_robot(name)
    if robot.epoch != was:
        site.say(f"{name} is here" if robot.epoch else f"{name} is gone")
    view = site.take_held_back(name)
    if view is not None and robot.epoch == view.name.epoch:
        receive_view(site, view)


def receive_selection(site: Site, selection: Selection, now_s: float) -> list[ViewName]:
    """Pins the views that an operator holds on the screen; returns those that are not kept."""
    views = tuple(view for view in (selection.view_i, selection.view_j) if view is not None)
    site.pin((selection.operator, selection.session), views, now_s)
    note_selection(site, selection, now_s)
    for view in views:
        localize_past(site, view)
    return [view for view in views if view not in site.views]


def receive_update(site: Site, update: OperatorUpdate) -> list[Outcome]:
    """Applies an operator's update, and all that waited for it; what is returned is final and in
    the journal.
    """
    outcomes = site.correspondences.apply(
        update,
        keeps=site.views.__contains__,
        lift=lambda view, pixel: site.lifter.lift(site.views[view], np.asarray(pixel, np.float64)),
        encoded=lambda view: site.views[view].payload,
        knows=site.knows,
    )
    for outcome in outcomes:
        if outcome.accepted:
            site.pair(*outcome.pair).make_due("clicks")
            pair_queue.reweigh(site, outcome.pair)
            site.want_solution()
            for view in outcome.views:
                localize_past(site, view)
    note_clicks(site, outcomes)
    return outcomes


def urgent_job(site: Site) -> Job | None:
    """What an operator waits for: a pair whose correspondences changed. A worker of its own is kept
    for these.
    """
    job = _click_job(site)
    return None if job is None else replace(_by_recipe(site, job), urgent=True)


def next_job(site: Site, now_s: float) -> Job | None:
    """What to align next: views that an operator looks at, then what robots wait for, each kind in
    its turn. Where they wait for nothing, clicks: after a restart all pairs ever clicked are due.
    """
    job = back_job(site) or _robots_job(site, now_s) or _click_job(site)
    return None if job is None else _by_recipe(site, job)


def take_result(site: Site, done: Done, now_s: float) -> bool:
    """Files an alignment: as a robot's own motion, or between two robots; False if it says nothing
    of a pair, because it knew less of the operator's clicks than one that has ended before.
    """
    if isinstance(done.job, TrackJob):
        followed(site, done)
        return True
    return _paired(site, done, now_s)


def solve(site: Site, now_s: float, wanted: Collection[ViewName] | None = None) -> None:
    """Solves the fleet's graph; the solution says which pairs are worth aligning next.

    Args:
        wanted: keyframes whose covariances are wanted; if not told, those that robots hang on, as
            far as it is their turn.
    """
    nodes = site.keyframes()
    if not nodes:
        return
    site.set_gauge(gauge_of(site, nodes))
    first = {
        name: robot.track.keyframes[0]
        for name, robot in site.robots.items()
        if robot.track.keyframes
    }
    depth_m = site.set_depth(float(np.median([site.views[v].median_depth_m for v in nodes])))
    site.solved(
        solve_fleet(
            nodes,
            believed(site),
            click_factors(site),
            gauge=site.gauge,
            newest=first,
            previous=site.solution,
            settings=SolveSettings.at_depth(depth_m),
            wanted=_covariances_due(site) if wanted is None else wanted,
        )
    )
    note_refuted(site)
    note_repetition(site)
    reconsider(site)
    choose_anchor(site)
    level(site)
    pair_queue.update_priorities(site, now_s)
    note_solved(site)


def _by_recipe(site: Site, job: Job) -> Job:
    return replace(job, recipe=site.recipe, icp=site.icp)


def judge_correspondences(site: Site) -> list[RobotPair]:
    """How the solution sees the operator's work; the pairs for which that changed."""
    return judge(site)


def note_components(site: Site) -> bool:
    """Raises the gauge revision when a robot's component changed: poses before and after do not
    compare.
    """
    now: dict[str, str] = {}
    for name, robot in site.robots.items():
        placed = None if robot.track.newest is None else site.camera_pose(robot.track.newest.view)
        if placed is not None:
            now[name] = site.component_name(placed[0])
    changed = site.renew_components(now)
    if changed:
        site.raise_revision()
    for name, before in changed.items():
        site.say(f"{name} is now in component {now[name]} (was {before})")
    return bool(changed)


def _covariances_due(site: Site) -> set[ViewName]:
    """Keyframes that robots hang on and of which no covariance is known, and those of which it is
    oldest: each costs milliseconds in a large fleet.
    """
    here = {robot.track.newest.keyframe for robot in site.robots.values() if robot.track.newest}
    known = {} if site.solution is None else site.solution.nodes
    new = {view for view in here if view not in known or known[view].covariance is None}
    return site.take_turns(here, new, _COVARIANCES_AT_ONCE)


def _click_job(site: Site) -> Job | None:
    """The next pair whose correspondences changed. Somebody waits: features are not asked, but
    what they said of its views counts where it is known.
    """
    for a, b in list(site.agenda.clicks):
        record, job = site.pairs[a, b], _with_clicks(site, a, b)
        if job is None and record.running:
            continue  # what grows from clicks that are gone can be taken back once it is there
        record.make_due("nothing")
        if job is None:
            note_heard(site, (a, b), None, None)
            _unlink_operator(site, a, b)
            continue
        record.start("clicks")
        return replace(job, known=record.searched.get((job.i.name, job.j.name)), features=False)
    return None


def _search_job(site: Site, now_s: float) -> Job | None:
    """The next pair whose clicks found nothing sure quickly: features are asked beside them."""
    for a, b in list(site.agenda.search):
        record = site.pairs[a, b]
        if now_s < record.search_from_s:
            continue
        record.make_due("nothing")
        if (job := _with_clicks(site, a, b)) is not None:
            record.start()
            return job
    return None


def _with_clicks(site: Site, a: str, b: str) -> ClickJob | None:
    """A pair's correspondences, to be aligned between the views that most of them hang on."""
    found = clicks_between(site, a, b)
    if found is None:
        return None
    (i, j), clicks = found
    return ClickJob(
        site.encoded(i),
        site.encoded(j),
        starts=_known_starts(site, i, j),
        features=(a, b) not in site.skip,
        clicks=clicks,
    )


def _robots_job(site: Site, now_s: float) -> Job | None:
    """What robots wait for, each kind of work in its turn."""
    for kind, share in _SHARES.items():
        site.kinds.put(kind, share, 0.0)
    while (chosen := site.kinds.pick(0.0)) is not None:
        match chosen.key:
            case "track":
                job = track_job(site)
            case "wide":
                job = wide_job(site)
            case "search":
                job = _search_job(site, now_s)
            case _:
                job = _pair_job(site, now_s)
        if job is not None:
            return job
        site.kinds.remove(chosen.key)
    return None


def _pair_job(site: Site, now_s: float) -> Job | None:
    chosen = pair_queue.pick(site, now_s)
    if chosen is None:
        return None
    pair, (i, j) = chosen
    site.pairs[pair].start()
    return PairJob(site.encoded(i), site.encoded(j), _known_starts(site, i, j))


def _known_starts(site: Site, i: ViewName, j: ViewName) -> tuple[Start, ...]:
    """What the fleet already knows of two views: composed through other robots."""
    T = site.relative(i, j)
    return () if T is None else (Start("graph", T, 0.03),)


def _paired(site: Site, done: Done, now_s: float) -> bool:
    i, j = views = done.job.views
    pair = ordered_pair(i.robot, j.robot)
    record, result = site.pair(*pair), done.result
    by_clicks_alone = isinstance(done.job, ClickJob) and not done.job.features
    if record.overtaken and not by_clicks_alone:
        if result is None or result.verdict != "verified":
            _overtaken(site, done, now_s)
            return False
        record.make_due("clicks")  # what is verified stands, and clicks are heard about it
    record.stop(done.outcome, views, now_s, "clicks" if by_clicks_alone else "features")
    site.count("alignments")
    site.touch(*pair)
    note_repetition(site)
    if result is None:
        site.say(f"alignment of {i} and {j} failed: {done.error}")
        return True
    note_depths(site, done)
    note_mirror(site, done)
    note_open(site, done)
    if isinstance(done.job, ClickJob):
        _conclude_clicks(site, pair, done.job, result, now_s)
    by_clicks = isinstance(done.job, ClickJob) and result.verdict != "verified"
    record.learn(result, views, done.job.kind, done.job.features and not by_clicks)
    _conclude_link(site, done)
    pair_queue.enqueue(site, pair, now_s)
    return True


def _overtaken(site: Site, done: Done, now_s: float) -> None:
    """Features have found nothing sure while newer clicks were aligned without them: these are
    aligned once more with what features say, or features are asked again beside them.
    """
    pair = ordered_pair(done.job.i.name.robot, done.job.j.name.robot)
    record = site.pair(*pair)
    if isinstance(done.job, ClickJob) or done.result is None:
        record.stop_overtaken(done.job.views, None)
        if not record.clicks_due:
            record.search_later(now_s + QUIET_S)
    else:
        record.stop_overtaken(done.job.views, done.result)
        record.make_due("clicks")
        note_open(site, done)
    pair_queue.enqueue(site, pair, now_s)


def _conclude_clicks(
    site: Site, pair: RobotPair, job: ClickJob, result: PairResult, now_s: float
) -> None:
    """What the images said of a pair's clicks, and whether features are to be asked beside them."""
    record = site.pair(*pair)
    if not job.features and not record.clicks_due:
        sure = pair in site.skip or result.verdict == "verified"
        if sure:
            record.make_due("nothing")
        else:
            record.search_later(now_s + QUIET_S)
    note_heard(site, pair, job.clicks, result.hearing)
    if _refuses_clicks(result):
        _unlink_operator(site, *pair)


def _conclude_link(site: Site, done: Done) -> None:
    """The edge of the graph that an alignment is worth; what was sure of an ambiguous one is not
    any more.
    """
    (i, j), result = done.job.views, done.result
    at_i, at_j = site.attached(i), site.attached(j)
    if result is None or at_i is None or at_j is None:
        return
    if result.verdict == "ambiguous":
        site.unlink((at_i.keyframe, at_j.keyframe, "pair"))
    if accepted(result):
        _link_pair(site, at_i, at_j, done)


def _refuses_clicks(result: PairResult) -> bool:
    """Whether nothing may rest on the clicks that an alignment was made with."""
    hearing = result.hearing
    return not accepted(result) or (hearing is not None and not any(hearing.accepted))


def _unlink_operator(site: Site, a: str, b: str) -> None:
    """Takes back what grew from correspondences that are gone or that nothing confirms any more."""
    for key, edge in list(site.edges.items()):
        if edge.operator and {edge.a.robot, edge.b.robot} == {a, b}:
            site.unlink(key)


def _link_pair(site: Site, i: KeyframeRelativePose, j: KeyframeRelativePose, done: Done) -> None:
    assert done.result is not None
    known = all(h.keyframe in site.robot(h.keyframe.robot).track.keyframes for h in (i, j))
    if i.keyframe == j.keyframe or not known:  # a keyframe may have been dropped meanwhile
        return
    T, covariance = on_keyframes(done.result, i, j)
    job, result = done.job, done.result
    enough = isinstance(job, ClickJob) and len(job.clicks.z_i) >= FULL_POSE
    operator, grown = result.confirmed and enough, result.grown and enough
    # two parts of one robot's track join as two robots do: it does not know the way between them
    edge = Edge(
        *(i.keyframe, j.keyframe, T, covariance, result.verdict, "pair", operator, grown),
        p_grave=result.p_grave if result.p_grave < 1.0 else GRAVE_BY_VERDICT[result.verdict],
        structure=(
            None if result.structure is None else result.structure.seen_from(i.T_keyframe_view)
        ),
        singled_out=result.singled_out,
    )
    before = site.edges.get(edge.key)
    if before is None or operator or _rank(edge) >= _rank(before):
        site.link(edge)


def _rank(edge: Edge) -> int:
    return {"verified": 3, "plausible": 2}.get(edge.verdict, 0)
