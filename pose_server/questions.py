"""The facts from which the operator's questions are ranked."""

import numpy as np

from pose_server.fleet.questions import PairFacts, rank_questions
from pose_server.pairs.candidates import similarity
from pose_server.site import Site
from protocol.messages import Question


def questions(site: Site) -> tuple[Question, ...]:
    """What to ask the operator, best first."""
    if site.solution is None:
        return ()
    newest = {
        name: robot.track.newest.keyframe
        for name, robot in sorted(site.robots.items())
        if robot.track.newest is not None
    }
    if not newest:
        return ()
    depth_m = float(np.median([site.views[view].median_depth_m for view in newest.values()]))
    names = list(newest)
    pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
    facts = [_facts(site, a, b) for a, b in pairs if _is_up_to_the_operator(site, a, b)]
    return tuple(rank_questions(site.solution, newest, facts, depth_m, site.anchor))


def _is_up_to_the_operator(site: Site, a: str, b: str) -> bool:
    """Nobody is asked what the machine may still find out by itself."""
    if (a, b) in site.skip:
        return True
    record = site.pairs.get((a, b))
    return record is not None and bool(record.tried) and not record.untried and not record.running


def _facts(site: Site, a: str, b: str) -> PairFacts:
    at_a, at_b = site.robots[a].track.newest, site.robots[b].track.newest
    assert at_a is not None and at_b is not None
    record = site.pairs.get((a, b))
    failed = 0
    if record is not None and record.best is not None and record.best.verdict == "rejected":
        failed = sum("clicks" in tries for tries in record.tried.values())
    return PairFacts(
        i=a,
        j=b,
        view_i=at_a.keyframe,
        view_j=at_b.keyframe,
        similarity=similarity(site, at_a.keyframe, at_b.keyframe),
        correspondences=len(site.book.of(a, b)),
        failed=failed,
    )
