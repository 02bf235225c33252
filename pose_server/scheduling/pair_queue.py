"""Which pair of robots is aligned next, and why.

A keyframe is laid beside those of the other robots when the fleet's solution knows it. What looks
promising waits in one of three lines: pairs that may join two components, pairs of which that is
unlikely, and pairs within one component that make it firmer. In each it is the turn of every pair
in proportion to its weight.
"""

from fleetpose.pose_server.scheduling.proposals import (
    BEST_OF_ROBOT,
    LEAST_OVERLAP,
    by_poses,
    expected_overlaps,
    to_compare,
)
from fleetpose.pose_server.scheduling.retries import retries_due
from fleetpose.pose_server.scheduling.settings import Line
from fleetpose.pose_server.scheduling.weights import pair_weight
from fleetpose.pose_server.state.pair_queue import SHARES
from fleetpose.pose_server.state.pairs import PairRecord, ViewPair
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import RobotPair, ordered_pair
from fleetpose.protocol.messages import ViewName

_LAID_AT_ONCE = 100  # keyframes; the state is told in between


def note_keyframe(site: Site, view: ViewName) -> None:
    """A new keyframe will be laid beside the others when the fleet is solved."""
    site.pair_queue.note_keyframe(view)


def update_priorities(site: Site, now_s: float) -> None:
    """After a solve: lays new keyframes beside the others, and thinks again about those whose
    components were joined or fell apart.
    """
    queue, solution = site.pair_queue, site.solution
    if solution is None:
        return
    if queue.see_components(frozenset(solution.components)):
        sharpening = queue.lines["sharpening"]
        for line in queue.lines.values():
            for pair in line.waiting():
                record, joined = site.pairs[pair], line is sharpening
                if any(site.joined(*views) != joined for views in _waiting(site, record)):
                    _think_again(site, record)
                    enqueue(site, pair, now_s)
    for view in queue.take_fresh(site.views, solution.nodes, _LAID_AT_ONCE):
        _propose_pairs(site, view, now_s)
    if queue.any_fresh(solution.nodes):
        site.want_solution()


def compare_some(site: Site, now_s: float, most: int = 10) -> bool:
    """Compares the looks of so many pairs of views; whether any were left to compare."""
    queue, compared = site.pair_queue, 0
    while compared < most and (views := queue.next_to_compare()) is not None:
        a, b = views
        if a in site.views and b in site.views and not site.joined(a, b):
            compared += 1
            note_promise(site, a, b, site.similarity(a, b), now_s)
    return compared > 0


def note_promise(site: Site, a: ViewName, b: ViewName, promise: float, now_s: float) -> None:
    """Two keyframes of different robots, or of parts of one, may be worth aligning."""
    pair = ordered_pair(a.robot, b.robot)
    record = site.pair(*pair)
    if pair in site.skip:
        return
    views = (a, b) if (a.robot, a.seq) < (b.robot, b.seq) else (b, a)
    if views in record.tried:
        return
    record.propose(views, promise)
    enqueue(site, pair, now_s)


def enqueue(site: Site, pair: RobotPair, now_s: float) -> None:
    """Puts a pair into the line it belongs to, with its weight, or takes it out."""
    record, queue = site.pairs[pair], site.pair_queue
    line, promise = _line_of(site, record)
    for other, turns in queue.lines.items():
        if other != line:
            turns.remove(pair)
    if line is not None:
        weight = pair_weight(site, pair, record, line, promise)
        queue.lines[line].put(pair, weight, now_s)


def reweigh(site: Site, pair: RobotPair) -> None:
    """Gives a pair that waits the weight that it has now; it keeps its place in the line."""
    for line, turns in site.pair_queue.lines.items():
        if pair in turns:
            record = site.pairs[pair]
            promise = _line_of(site, record)[1]
            turns.put(pair, pair_weight(site, pair, record, line, promise), 0.0)


def try_again(site: Site, robot: Robot, now_s: float) -> None:
    """A robot's newest view hangs on a keyframe: pairs of which the last alignment failed may wait
    once more.
    """
    for pair in retries_due(site, robot, now_s):
        enqueue(site, pair, now_s)


def pick(site: Site, now_s: float) -> tuple[RobotPair, ViewPair] | None:
    """The pair whose turn it is, and its most promising keyframes, which are taken off the list."""
    queue = site.pair_queue
    for line, turns in queue.lines.items():
        if len(turns):
            queue.kinds.put(line, SHARES[line], 0.0)
        else:
            queue.kinds.remove(line)
    while (kind := queue.kinds.pick(0.0)) is not None:
        chosen = queue.lines[kind.key].pick(now_s, site.agenda.running)
        if chosen is None:
            queue.kinds.remove(kind.key)  # all of its pairs are at work
            continue
        record = site.pairs[chosen.key]
        joining = kind.key != "sharpening"
        waiting = _waiting(site, record)
        fitting = {v: promise for v, promise in waiting.items() if site.joined(*v) != joining}
        if not fitting:
            enqueue(site, chosen.key, now_s)
            continue
        views, promise = max(fitting.items(), key=lambda one: one[1])
        record.take(views)
        queue.note_pick(chosen, _why(kind.key, promise))
        enqueue(site, chosen.key, now_s)
        return chosen.key, views
    return None


def _line_of(site: Site, record: PairRecord) -> tuple[Line | None, float]:
    """The line that a pair belongs to, and what its best views promise there."""
    waiting = _waiting(site, record)
    apart = [promise for views, promise in waiting.items() if not site.joined(*views)]
    if apart:
        promise = max(apart)
        return ("joining" if promise > 0.0 else "unlikely"), promise
    if waiting:
        return "sharpening", max(waiting.values())
    return None, 0.0


def _waiting(site: Site, record: PairRecord) -> dict[ViewPair, float]:
    """What two robots' views promise that wait to be aligned: keyframes, and those to be tried
    again while they are kept.
    """
    if record.retry is None or not all(view in site.views for view in record.retry):
        return record.untried
    return {record.retry: record.retry_promise, **record.untried}


def _propose_pairs(site: Site, view: ViewName, now_s: float) -> None:
    for other, overlap in by_poses(site, view).items():
        note_promise(site, view, other, overlap, now_s)
    pairs = ((view, other) for other in to_compare(site, view))
    for a, b in pairs:
        if ordered_pair(a.robot, b.robot) not in site.skip:
            site.pair_queue.compare_later(a, b)
        else:
            site.pair(a.robot, b.robot)


def _think_again(site: Site, record: PairRecord) -> None:
    """Where poses now say what two views see in common, they count instead of looks."""
    for a, b in list(record.untried):
        if not site.joined(a, b):
            continue
        overlap = float(expected_overlaps(site, a, [b])[0])
        if a.robot == b.robot or overlap < LEAST_OVERLAP:
            record.withdraw({(a, b)})
        else:
            record.propose((a, b), overlap)
    joined = [views for views in record.untried if site.joined(*views)]
    record.withdraw(sorted(joined, key=lambda one: -record.untried[one])[BEST_OF_ROBOT:])


def _why(line: Line, promise: float) -> str:
    return {
        "joining": f"may join two components, its views look alike to {promise:.0%}",
        "unlikely": "its views do not look alike, but nothing joins them yet",
        "sharpening": f"would make the fleet firmer, expected overlap {promise:.0%}",
    }[line]
