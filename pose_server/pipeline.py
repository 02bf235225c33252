"""The two flows, free of I/O and clocks: what becomes of a view, and what becomes of a click.

A view: `receive_view` -> `next_job` (follow it on its robot's keyframes, then the most promising
    pair) ~~ a worker
aligns ~~ `take_result` -> `solve`. A click: `receive_update` (validated, lifted, journalled) ->
`next_job` (first in line) ~~ a worker aligns ~~ `take_result` -> `solve`. The shell publishes what
changed.
"""

from collections.abc import Sequence

import numpy as np

from pose_server.clicks import click_factors, clicks_between, judge
from pose_server.correspondences.book import Outcome
from pose_server.fleet.graph import solve_fleet
from pose_server.fleet.types import Edge, SolveSettings
from pose_server.pairs.align import Start
from pose_server.pairs.candidates import candidate_views, offer_keyframe, weights
from pose_server.pairs.engine import Done, Job
from pose_server.pairs.judging import PairResult
from pose_server.pairs.tracking import Attached, accepted, moved
from pose_server.site import Robot, RobotPair, Site, on_keyframes
from pose_server.views import STILL_PX, KeptView, lift_click, stands_still
from protocol.messages import OperatorUpdate, ViewName

MAX_KEYFRAMES = 40


def receive_view(site: Site, view: KeptView) -> None:
    """Keeps a view; the newest one of each robot waits to be followed."""
    robot = site.robot(view.name.robot)
    site.views.keep(view)
    site.count("views")
    robot.newest = robot.waiting = view.name
    if not robot.track.keyframes:
        robot.waiting = None
        _new_keyframe(site, robot, view.name)
    elif _stayed(site, robot, view):
        robot.waiting = None


def receive_update(site: Site, update: OperatorUpdate) -> list[Outcome]:
    """Applies an operator's update, and all that waited for it; what is returned is final and in
    the journal.
    """
    outcomes = site.book.apply(
        update,
        keeps=site.views.__contains__,
        lift=lambda view, pixel: lift_click(site.views[view], np.asarray(pixel, np.float64)),
        encoded=lambda view: site.views[view].payload,
    )
    for outcome in outcomes:
        if outcome.accepted:
            site.pair(*outcome.pair).clicks_due = True
            site.dirty = True
    return outcomes


def next_job(site: Site, now_s: float) -> Job | None:
    """What to align next: the operator's pairs, then the robots' own motion, then the pair whose
    turn it is.
    """
    if (job := _click_job(site)) is not None:
        return job
    site.pair_is_due = not site.pair_is_due
    joining = _pair_job(site, now_s, joining=True) if site.pair_is_due else None
    return (
        joining
        or _track_job(site)
        or _pair_job(site, now_s, joining=True)
        or _pair_job(site, now_s, joining=False)
    )


def take_result(site: Site, done: Done, now_s: float) -> None:
    """Files an alignment: as a robot's own motion, or between two robots."""
    if done.job.purpose == "track":
        _followed(site, done)
    else:
        _paired(site, done, now_s)


def solve(site: Site) -> None:
    """Solves the fleet's graph and lets the solution judge links and correspondences."""
    nodes = site.keyframes()
    if not nodes:
        return
    site.gauge = _gauge(site, nodes)
    first = {
        name: robot.track.keyframes[0]
        for name, robot in site.robots.items()
        if robot.track.keyframes
    }
    wanted = {robot.track.newest.keyframe for robot in site.robots.values() if robot.track.newest}
    site.solution = solve_fleet(
        nodes,
        list(site.edges.values()),
        click_factors(site),
        gauge=site.gauge,
        newest=first,
        previous=site.solution,
        settings=_settings(site, nodes),
        wanted=wanted,
    )
    site.dirty = False
    site.count("solves")
    _choose_anchor(site)


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
    changed = [
        name for name, component in now.items() if site.components.get(name, component) != component
    ]
    if changed:
        site.gauge_revision += 1
        for name in changed:
            site.say(f"{name} is now in component {now[name]} (was {site.components[name]})")
    site.components = now
    return bool(changed)


def restore(site: Site, clicked_views: Sequence[KeptView]) -> None:
    """After a restart: the views of the journal's correspondences are keyframes again, and all
    pairs are due.
    """
    for view in clicked_views:
        robot = site.robot(view.name.robot)
        site.views.keep(view)
        robot.track.recall(view.name)
        offer_keyframe(site, view.name)
    for pair in site.book.pairs():
        site.pair(*pair).clicks_due = True
    site.dirty = bool(clicked_views)


def _settings(site: Site, nodes: Sequence[ViewName]) -> SolveSettings:
    depth = float(np.median([site.views[node].median_depth_m for node in nodes]))
    return SolveSettings(
        floor_translation_m=3e-4 * depth, agree_translation_m=0.05 * depth, distinct_m=0.02 * depth
    )


def _gauge(site: Site, nodes: Sequence[ViewName]) -> ViewName | None:
    """The anchor's first keyframe; it stays the origin as long as it is kept."""
    if site.gauge in nodes and site.gauge is not None and site.gauge.robot == site.anchor:
        return site.gauge
    return next((node for node in nodes if node.robot == site.anchor), None)


def _choose_anchor(site: Site) -> None:
    """The first robot by name of the largest component of two or more; once chosen it stays."""
    if site.anchor is not None or site.solution is None:
        return
    fleets = [{view.robot for view in views} for views in site.solution.components.values()]
    largest = max(fleets, key=len)
    if len(largest) > 1:
        site.anchor = min(largest)
        site.dirty = True
        site.say(f"{site.anchor} is the anchor: the fleet's origin")


def _click_job(site: Site) -> Job | None:
    for (a, b), record in site.pairs.items():
        if not record.clicks_due or record.running:
            continue
        record.clicks_due = False
        found = clicks_between(site, a, b)
        if found is None:
            _unlink_operator(site, a, b)
            continue
        views, clicks = found
        i, j = views
        record.running = True
        return Job(
            "clicks",
            site.views[i].encoded,
            site.views[j].encoded,
            starts=_known_starts(site, i, j),
            features=(a, b) not in site.skip,
            clicks=clicks,
        )
    return None


def _track_job(site: Site) -> Job | None:
    waiting = [robot for robot in site.robots.values() if robot.waiting and robot.tracking is None]
    if not waiting:
        return None
    robot = min(waiting, key=lambda r: _followed_s(site, r))
    view, robot.waiting = robot.waiting, None
    assert view is not None
    return _follow(site, robot, view)


def _followed_s(site: Site, robot: Robot) -> float:
    """When the newest view that hangs somewhere was received: who lags most is next."""
    newest = robot.track.newest
    kept = None if newest is None else site.views.get(newest.view)
    return -np.inf if kept is None else kept.received_s


def _follow(site: Site, robot: Robot, view: ViewName) -> Job | None:
    """The next try to hang a view on one of its robot's keyframes."""
    keyframe = robot.track.next_try(view, lambda: candidate_views(site, robot, view))
    if keyframe is None or keyframe not in site.views:
        robot.tracking = None
        if robot.track.give_up(view) == "segment":
            site.say(f"{robot.name} lost track of itself: its view {view.seq} begins a new segment")
        _new_keyframe(site, robot, view)
        return None
    robot.tracking = view
    starts: tuple[Start, ...] = ()
    if robot.track.newest is not None and robot.track.newest.keyframe == keyframe:
        starts = (Start("previous", robot.track.newest.T_keyframe_view, 0.03),)
    return Job("track", site.views[keyframe].encoded, site.views[view].encoded, starts)


def _stayed(site: Site, robot: Robot, view: KeptView) -> bool:
    """Hangs a view on the reference without a worker where no pixel moved."""
    reference = robot.track.reference
    if reference is None or reference not in site.views:
        return False
    if not stands_still(site.views[reference], view):
        return False
    sigma_rad = STILL_PX / float(view.camera.K[0, 0])
    robot.track.stay(view.name, reference, sigma_rad, sigma_rad * view.median_depth_m)
    return True


def _followed(site: Site, done: Done) -> None:
    view, keyframe = done.job.j.name, done.job.i.name
    robot = site.robot(view.robot)
    robot.tracking = None
    if view not in site.views or keyframe not in site.views:
        return
    step = "try"
    if done.result is not None:
        depth = site.views[view].median_depth_m
        nearer = _nearer_keyframe(site, robot, keyframe, done.result, depth)
        step = robot.track.take(view, keyframe, done.result, depth, nearer)
    if step == "keyframe":
        _new_keyframe(site, robot, view)
    elif step == "try" and robot.waiting is None:
        robot.waiting = view
    elif step == "try":
        site.count("views_overtaken")
    if step == "attached" and site.solution is not None:
        node = site.solution.nodes.get(robot.track.attached[view].keyframe)
        site.dirty |= node is None or node.covariance is None


def _nearer_keyframe(
    site: Site, robot: Robot, keyframe: ViewName, result: PairResult, depth_m: float
) -> ViewName | None:
    """Another keyframe of the robot that a view is near to, judged by the solution."""
    if not accepted(result) or result.T_i_j is None:
        return None
    near: list[tuple[float, ViewName]] = []
    for other in robot.track.keyframes:
        T = None if other == keyframe else site.relative(other, keyframe)
        if T is not None:
            near.append((moved(T @ result.T_i_j, depth_m), other))
    distance, other = min(near, default=(np.inf, None), key=lambda pair: pair[0])
    return other if distance < 0.8 else None


def _new_keyframe(site: Site, robot: Robot, view: ViewName) -> None:
    """Makes a view a keyframe, links it to the one it was aligned with, and offers it to the other
    robots.
    """
    link = robot.track.link_of(view)
    robot.track.begin(view)
    if link is not None:
        site.link(
            Edge(
                link.keyframe, view, link.T_keyframe_view, link.covariance, link.verdict, "odometry"
            )
        )
    offer_keyframe(site, view)
    site.dirty = True
    if len(robot.track.keyframes) > MAX_KEYFRAMES:
        _drop_keyframe(site, robot)


def _drop_keyframe(site: Site, robot: Robot) -> None:
    """Forgets the oldest keyframe that nothing important hangs on."""
    clicked = {site.attached(view) for view in site.book.views()}
    kept = {here.keyframe for here in clicked if here is not None}
    kept |= {site.gauge, robot.track.reference}
    oldest = next((view for view in robot.track.keyframes if view not in kept), None)
    if oldest is None:
        return
    robot.track.forget({oldest})
    for key in [key for key in site.edges if oldest in key[:2]]:
        site.unlink(key)
    site.similarities = {v: like for v, like in site.similarities.items() if oldest not in v}
    for record in site.pairs.values():
        record.untried = {
            views: like for views, like in record.untried.items() if oldest not in views
        }


def _pair_job(site: Site, now_s: float, joining: bool) -> Job | None:
    pair = site.turn.pick(weights(site, now_s, joining))
    if pair is None:
        return None
    record = site.pairs[pair]
    fitting = [views for views in record.untried if site.joined(*views) != joining]
    views = max(fitting, key=lambda v: record.untried[v])
    record.untried.pop(views)
    record.running = True
    waited_s = now_s - (record.waiting_since_s or now_s)
    record.waiting_since_s = None
    site.max_wait_s = max(site.max_wait_s, waited_s)
    i, j = views
    return Job("pair", site.views[i].encoded, site.views[j].encoded, _known_starts(site, i, j))


def _known_starts(site: Site, i: ViewName, j: ViewName) -> tuple[Start, ...]:
    """What the fleet already knows of two views: composed through other robots."""
    T = site.relative(i, j)
    return () if T is None else (Start("graph", T, 0.03),)


def _paired(site: Site, done: Done, now_s: float) -> None:
    i, j = done.job.i.name, done.job.j.name
    record = site.pair(i.robot, j.robot)
    record.running = False
    record.alignments += 1
    site.count("alignments")
    record.last_s = now_s
    if done.result is None:
        site.say(f"alignment of {i} and {j} failed: {done.error}")
        return
    record.tried.setdefault((i, j), set()).add(done.job.purpose)
    record.last, record.last_views = done.result, (i, j)
    if _is_better(done.result, record.best):
        record.best, record.best_views = done.result, (i, j)
    at_i, at_j = site.attached(i), site.attached(j)
    if done.job.purpose == "clicks" and not accepted(done.result):
        _unlink_operator(site, i.robot, j.robot)
    if accepted(done.result) and at_i is not None and at_j is not None:
        _link_pair(site, at_i, at_j, done)


def _unlink_operator(site: Site, a: str, b: str) -> None:
    """Takes back what grew from correspondences that are gone or that nothing confirms any more."""
    for key, edge in list(site.edges.items()):
        if edge.operator and {edge.a.robot, edge.b.robot} == {a, b}:
            site.unlink(key)


def _link_pair(site: Site, i: Attached, j: Attached, done: Done) -> None:
    assert done.result is not None
    T, covariance = on_keyframes(done.result, i, j)
    kind = "odometry" if i.keyframe.robot == j.keyframe.robot else "pair"
    if i.keyframe == j.keyframe:
        return
    clicks = done.job.clicks
    operator = done.result.start == "operator" and clicks is not None and len(clicks.z_i) >= 3
    edge = Edge(i.keyframe, j.keyframe, T, covariance, done.result.verdict, kind, operator)
    before = site.edges.get(edge.key)
    if before is None or operator or _rank(edge) >= _rank(before):
        site.link(edge)


def _rank(edge: Edge) -> int:
    return {"verified": 3, "plausible": 2}.get(edge.verdict, 0)


_GOOD = {"verified": 3, "plausible": 2, "ambiguous": 1, "rejected": 0}


def _is_better(new: PairResult, old: PairResult | None) -> bool:
    """Verdict first, then inliers: what a pair shows in the matrix is its best alignment."""
    if old is None:
        return True
    return (_GOOD[new.verdict], new.inliers) >= (_GOOD[old.verdict], old.inliers)
