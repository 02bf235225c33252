"""The facts from which the operator's questions are ranked."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.frames import sigma_by_grave
from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.questions import overlap_prior
from fleetpose.pose_server.questions.overlap_prior import Attempt, Look
from fleetpose.pose_server.questions.ranking import PairFacts, rank_questions
from fleetpose.pose_server.questions.suggestions import with_suggestions
from fleetpose.pose_server.state.pairs import PairRecord, ViewPair
from fleetpose.pose_server.state.question_feedback import Asked
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import RobotPair, ordered_pair
from fleetpose.protocol.messages import Question, ViewName

Floats = npt.NDArray[np.floating]

_RENEWED_S = 1.0
# Chance that two views which look quite alike share enough to click, if no found pose is right
_LIKE_UNTRIED, _LIKE_TRIED, _LEAST = 0.6, 0.15, 0.02
_USUAL_LIKENESS = 0.5


def questions(site: Site, now_s: float = float("inf")) -> tuple[Question, ...]:
    """What to ask the operator, best first; ranked anew when something changed. Where that is no
    more than numbers, a second later will do.
    """
    newest = site.newest_keyframes()
    if site.solution is None or not newest:
        return ()
    parts = (
        frozenset(site.solution.components),
        site.anchor,
        sum(site.feedback.in_vain.values()),
        tuple(newest.values()),
        tuple(
            pair
            for pair in (*site.agenda.tried, *sorted(site.skip & site.pairs.keys()))
            if _is_up_to_the_operator(site, *pair)
        ),
    )
    numbers = site.solution, site.counts.get("alignments", 0), len(site.correspondences.all())
    asked = site.feedback.asked
    another = asked.parts != parts
    if another or (asked.numbers != numbers and now_s >= asked.at_s + _RENEWED_S):
        asked = Asked(parts, numbers, now_s, _ranked(site, newest))
        site.feedback.ask(asked)
    if asked.shown is None or now_s >= asked.shown_s + _RENEWED_S:
        asked = replace(asked, shown=with_suggestions(site, asked.questions), shown_s=now_s)
        site.feedback.ask(asked)
    return asked.shown or ()


def _ranked(site: Site, newest: dict[str, ViewName]) -> tuple[Question, ...]:
    assert site.solution is not None
    depth_m = float(np.median([site.views[view].median_depth_m for view in newest.values()]))
    known = {name: view for name, view in newest.items() if view in site.solution.nodes}
    wanted = [
        (a, b)
        for a, b in sorted(site.pairs.keys() | site.skip)
        if a != b and a in known and b in known and _is_up_to_the_operator(site, a, b)
    ]
    facts = [
        _facts(site, pair, known, chance) for pair, chance in _chances(site, known, wanted).items()
    ]
    ranked = rank_questions(
        site.solution,
        newest,
        facts,
        depth_m,
        site.anchor,
        located_sigma=min(site.located_sigma, sigma_by_grave(site.located_grave)),
        located_grave=site.located_grave,
    )
    return tuple(ranked)


def _is_up_to_the_operator(site: Site, a: str, b: str) -> bool:
    """Nobody is asked what the machine may still find out by itself, or where there is hardly any
    depth to click at, or an image of the past.
    """
    if any(name in site.robots and site.robots[name].blind for name in (a, b)):
        return False
    doubts = (site.doubts.standing.get(name) for name in (a, b))
    if any(doubt is not None and doubt.kind == "frozen" for doubt in doubts):
        return False
    if (a, b) in site.skip:
        return True
    record = site.pairs.get((a, b))
    return record is not None and bool(record.tried) and not record.untried and not record.running


def _chances(
    site: Site, newest: dict[str, ViewName], wanted: Sequence[RobotPair]
) -> dict[RobotPair, float]:
    """How likely each two robots see enough of the same: by the solution where they are joined, by
    what aligning the two parts of the fleet left as hypotheses where they are not.
    """
    assert site.solution is not None
    roots = {name: site.solution.nodes[view].root for name, view in newest.items()}
    looks = {name: _look(site, view) for name, view in newest.items()}
    parts: dict[ViewName, list[str]] = defaultdict(list)
    for name, root in roots.items():
        parts[root].append(name)
    found: dict[RobotPair, float] = {}
    joined: dict[str, list[str]] = defaultdict(list)
    tables: dict[frozenset[ViewName], dict[RobotPair, float]] = {}
    for first, second in wanted:
        a, b = roots[first], roots[second]
        if a == b:
            joined[first].append(second)
            continue
        between = frozenset((a, b))
        if between not in tables:
            tables[between] = _chances_apart(site, parts[a], parts[b], newest, looks)
        found[first, second] = tables[between][first, second]
    for first, others in joined.items():
        found |= _chances_joined(site, first, others, newest, looks)
    return found


def _chances_joined(
    site: Site,
    first: str,
    others: Sequence[str],
    newest: dict[str, ViewName],
    looks: dict[str, Look],
) -> dict[RobotPair, float]:
    """Of a robot and others of its part, which come after it in order."""
    seen = overlap_prior.overlap_probability(
        *overlap_prior.apart([looks[first]], [looks[other] for other in others], np.eye(4))
    )
    pairs = [(first, other) for other in others]
    aligned = np.array([[_aligned_so(site, pair, newest) for pair in pairs]])
    chances = overlap_prior.if_aligned(seen, aligned)[0]
    return dict(zip(pairs, map(float, chances), strict=True))


def _chances_apart(
    site: Site,
    names_a: Sequence[str],
    names_b: Sequence[str],
    newest: dict[str, ViewName],
    looks: dict[str, Look],
) -> dict[RobotPair, float]:
    """Of all pairs between two parts: what is known of one pair tells of the others."""
    table = overlap_prior.overlap_probabilities(
        [looks[name] for name in names_a],
        [looks[name] for name in names_b],
        _tries(site, names_a, names_b, newest),
    )
    return {
        ordered_pair(first, second): float(table[m, n])
        for m, first in enumerate(names_a)
        for n, second in enumerate(names_b)
    }


def _aligned_so(site: Site, pair: RobotPair, newest: dict[str, ViewName]) -> bool:
    """Whether aligning two joined robots found them to stand as the solution has them."""
    record = site.pairs.get(pair)
    views = (newest[pair[0]], newest[pair[1]])
    if record is None or record.best is None or record.best.T_i_j is None:
        return False
    T, known = _carried(site, record, views), site.relative(*views)
    if T is None or known is None:
        return False
    return overlap_prior.alike(T, known, site.views[views[0]].median_depth_m)


def _look(site: Site, view: ViewName) -> Look:
    assert site.solution is not None
    kept = site.views[view]
    size = (kept.camera.width, kept.camera.height)
    T = site.solution.nodes[view].T_root_camera
    return Look(T, kept.camera.K, size, kept.median_depth_m)


def _tries(
    site: Site, names_a: Sequence[str], names_b: Sequence[str], newest: dict[str, ViewName]
) -> list[Attempt]:
    tries = []
    for m, first in enumerate(names_a):
        for n, second in enumerate(names_b):
            pair = ordered_pair(first, second)
            record = site.pairs.get(pair)
            like = _likeness(site, newest[first], newest[second])
            vain = _in_vain(site, pair, newest)
            best = None if record is None else record.best
            otherwise = _LEAST + like * (_LIKE_UNTRIED if best is None else _LIKE_TRIED)
            T = None
            if record is not None and best is not None and best.T_i_j is not None:
                T = _carried(site, record, (newest[first], newest[second]))
            odds = overlap_prior.log_odds(None if best is None else best.evidence)
            tries.append(Attempt(m, n, T, odds, vain, otherwise))
    return tries


def _likeness(site: Site, a: ViewName, b: ViewName) -> float:
    """How much two views look alike, compared here only where no alignment says more."""
    known = site.known_similarity(a, b)
    if known is None and ordered_pair(a.robot, b.robot) in site.skip:
        known = site.similarity(a, b)
    return _USUAL_LIKENESS if known is None else known


def _carried(site: Site, record: PairRecord, to: ViewPair) -> Floats | None:
    """What a pair's best alignment says of two other keyframes of its robots, T_a_b; none where
    the solution does not know how these hang together.
    """
    assert record.best is not None and record.best.T_i_j is not None
    assert record.best_views is not None
    (i, j), T_i_j = record.best_views, record.best.T_i_j
    if i.robot != to[0].robot:
        i, j, T_i_j = j, i, inverse(T_i_j)
    T_a_i = np.eye(4) if i == to[0] else site.relative(to[0], i)
    T_j_b = np.eye(4) if j == to[1] else site.relative(j, to[1])
    return None if T_a_i is None or T_j_b is None else T_a_i @ T_i_j @ T_j_b


def _in_vain(site: Site, pair: RobotPair, newest: dict[str, ViewName]) -> int:
    """How often an operator looked at a pair without a click, in the views it is asked by."""
    record = site.pairs.get(pair, PairRecord())
    shown = [(newest[pair[0]], newest[pair[1]]), record.best_views, record.last_views]
    return site.feedback.times_in_vain([views for views in shown if views is not None])


def _facts(site: Site, pair: RobotPair, newest: dict[str, ViewName], chance: float) -> PairFacts:
    record = site.pairs.get(pair, PairRecord())
    failed = 0
    if record.best is not None and record.best.verdict == "rejected":
        failed = sum("clicks" in tries for tries in record.tried.values())
    return PairFacts(
        i=pair[0],
        j=pair[1],
        view_i=newest[pair[0]],
        view_j=newest[pair[1]],
        chance=chance,
        correspondences=len(site.correspondences.of(*pair)),
        failed=failed,
        in_vain=_in_vain(site, pair, newest),
        fruitless=site.feedback.fruitless(pair),
        verified=record.best is not None and record.best.verdict == "verified",
        why=_why(pair, record, chance),
    )


def _why(pair: RobotPair, record: PairRecord, chance: float) -> str:
    """What speaks for asking, and what is to be looked for."""
    i, j = pair
    last = record.last
    if last is not None and last.verdict == "ambiguous" and last.T_i_j is not None and last.rivals:
        apart = inverse(last.T_i_j) @ last.rivals[0]
        turn_deg = np.degrees(rotation_angle(apart[:3, :3]))
        return (
            f"{i}-{j} fits {1 + len(last.rivals)} ways, {np.linalg.norm(apart[:3, 3]):.2g} m and "
            f"{turn_deg:.0f} deg apart: is there something that exists only once?"
        )
    told = record.told or record.contradicted
    if told:
        return f"{told[0].upper()}{told[1:]}."
    return f"The chance that they show the same is {chance:.0%}."
