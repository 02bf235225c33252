"""A pair's alignment and the operator's clicks: who is to be believed, and what is told.

The images decide. A verified pose stands, unless they like what was clicked as well. Else every set
of clicks that agrees with itself proposes a pose, and the one that the images support best is
taken; where they say nothing, as between views from very different sides, the clicks make it
plausible, but nobody is located by that. What the images contradict, whoever clicked it, is refused
and named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.consensus import OUTLIER_CHI2
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.registration.operator_starts import (
    BY_CLICKS,
    FULL_POSE,
    OPERATOR,
    Clicks,
    OperatorStart,
    by_clicks,
    operator_starts,
    starts_from_clicks,
)
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.refinement import from_start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.registration.verdict.hearing import Heard, Hearing, hear
from fleetpose.pose_server.registration.verdict.unique import on_unique_structure
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ClickedSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    # probability of a grave error of clicks that images support: they are for one wrong pose in
    # ten at most
    p_supported: float = 0.006
    p_unsupported: float = 0.1  # of clicks that images could support and do not
    # of clicks where there is nothing in the images: the operator's word stands
    p_blank: float = 0.01
    much_better: float = 2.0  # found as large a share again: the images fit another pose


CLICKED = in_use("clicked", ClickedSettings())

_RANK = {"for": 2, "blank": 1, "nothing": 1, "against": 0}  # an order


def with_clicks(
    result: PairResult,
    sets: Sequence[OperatorStart],
    clicks: Clicks,
    i: PreparedView,
    j: PreparedView,
) -> PairResult:
    """What becomes of an alignment by the clicks that were made in its views.

    Args:
        result: what features, and all starts, have led to.
        sets: of clicks that agree, and their poses.
        clicks: all of them.
        i, j: the views.
    """
    heard = _with_clicks(result, sets, clicks, i, j)
    return replace(heard, by_clicks=by_clicks(sets, clicks, heard.T_i_j) if sets else None)


def _with_clicks(
    result: PairResult,
    sets: Sequence[OperatorStart],
    clicks: Clicks,
    i: PreparedView,
    j: PreparedView,
) -> PairResult:
    full = [one for one in sets if one.covariance is not None and one.alone]
    if not full:
        return _undetermined(result, clicks, i, j)
    if result.T_i_j is not None and result.verdict == "verified":
        agreeing = [one for one in full if _back(one, result.T_i_j)]
        if agreeing:
            return _confirmed(result, agreeing[0])
    pair = Pair(i, j, PAIR.ratio)
    heard = [(one, _heard(pair, one, result)) for one in full]
    best, said = max(heard, key=lambda both: _weight(*both))
    if result.verdict == "verified" and not _as_good(pair, said, result):
        return _outdone(result, best, pair)
    if said.says == "against":
        return _refused(result, best, said, clicks, pair)
    if _has_a_rival(pair, result, best, said):
        return _open(result, best, said, pair)
    if not _breaks_the_tie(pair, result, best, said):
        return _tied(result, best, said, pair)
    return _believed(result, best, said, pair)


def _undetermined(
    result: PairResult, clicks: Clicks, i: PreparedView, j: PreparedView
) -> PairResult:
    """Clicks that determine no pose: too few as yet, or they say why not."""
    told = ""
    if len(clicks.z_i) >= FULL_POSE:
        try:
            told = starts_from_clicks(i, j, clicks, ())[0].note
        except DegenerateGeometryError as error:
            told = str(error)
        told = f"the points in {i.name.robot} and {j.name.robot} determine no pose: {told}"
    hearing = Hearing((True,) * len(clicks.z_i), 1.0, told)
    return replace(result, confirmed=False, grown=False, hearing=hearing)


def _heard(pair: Pair, one: OperatorStart, result: PairResult) -> Heard:
    """What the images say of the pose of a set of clicks, or of what they make of it themselves
    as long as these clicks agree with that, whichever they like best.
    """
    poses = [one.start.T_i_j]
    if result.T_i_j is not None and _back(one, result.T_i_j):
        poses.insert(0, result.T_i_j)  # it is the sharper one where the images like both the same
    said = max((hear(pair, T, one.start.sigma) for T in poses), key=_liking)
    if said.says == "for":
        return said
    refined = [c.T_i_j for c in from_start(pair, one.start)[1:] if _back(one, c.T_i_j)]
    return max((said, *(hear(pair, T, one.start.sigma) for T in refined)), key=_liking)


def _liking(said: Heard) -> tuple[int, float]:
    return _RANK[said.says], said.share


def _weight(one: OperatorStart, said: Heard) -> tuple[float, ...]:
    """What the images support comes first, else what more clicks say, else what was said later."""
    number, count = np.arange(len(one.inliers)), int(one.inliers.sum())
    supported = said.share if said.says == "for" else 0.0
    return _RANK[said.says], supported, count, float(number[one.inliers].mean())


def _confirmed(result: PairResult, one: OperatorStart) -> PairResult:
    """A verified pose that clicks agree with."""
    assert result.T_i_j is not None
    hearing = Hearing(_agreeing(one, result.T_i_j), min(result.p_grave, CLICKED.p_supported))
    return replace(result, confirmed=True, grown=result.start in BY_CLICKS, hearing=hearing)


def _back(one: OperatorStart, T: Floats) -> bool:
    """Whether clicks that agree with each other are for a pose found otherwise: three of them and
    most of them are. A pose that is sharper than theirs may well leave one of them out.
    """
    agreeing = int((np.array(_agreeing(one, T)) & one.inliers).sum())
    return agreeing >= FULL_POSE and 2 * agreeing > int(one.inliers.sum())


def _as_good(pair: Pair, said: Heard, result: PairResult) -> bool:
    """Whether the images like a clicked pose about as much as the verified one: an alias may have
    been verified, of which they explain less.
    """
    if said.says != "for" or result.T_i_j is None:
        return False
    return said.share > hear(pair, result.T_i_j).share / CLICKED.much_better


def _outdone(result: PairResult, best: OperatorStart, pair: Pair) -> PairResult:
    """The clicks are wrong: another pose is verified, and the images like that much better."""
    assert result.T_i_j is not None
    told = (
        f"your {_points(best)} in {pair.i.name.robot} and {pair.j.name.robot} fit each other, but "
        f"{result.inliers} matches of the images fit another pose: are these the same places?"
    )
    hearing = Hearing(_agreeing(best, result.T_i_j), 1.0, told)
    return replace(result, confirmed=False, grown=False, hearing=hearing)


def _p_grave(said: Heard) -> float:
    if said.says == "for":
        return CLICKED.p_supported
    return CLICKED.p_blank if said.says == "blank" else CLICKED.p_unsupported


def _believed(result: PairResult, best: OperatorStart, said: Heard, pair: Pair) -> PairResult:
    """The clicks make the pose plausible that the images like best of those they agree with: their
    own, or what features made of it. Either is as sure as the clicks are.
    """
    by_features = said.T_i_j is result.T_i_j
    p_grave = _p_grave(said)
    told = ""
    if said.says != "for":
        told = (
            f"your {_points(best)} in {pair.i.name.robot} and {pair.j.name.robot} fit each other, "
            "but the images neither confirm nor contradict them: more points, or a pair of views "
            "nearer to each other, would make sure"
        )
    accepted = _agreeing(best, said.T_i_j)
    if said.says != "for":  # clicks are judged by clicks alone: by what their pose leaves open too
        loosely = best.pairs.distance2(said.T_i_j, best.covariance) < OUTLIER_CHI2
        accepted = tuple((best.inliers | loosely).tolist())
    hearing = Hearing(accepted, p_grave, told)
    done = {"confirmed": True, "p_grave": p_grave, "hearing": hearing, "rivals": ()}
    if by_features and result.verdict == "plausible":
        return replace(result, grown=result.start in BY_CLICKS, **done)
    count = int(best.inliers.sum())
    reason = (
        f"{count} correspondences agree with it"
        if by_features
        else f"by {count} correspondences alone"
    )
    return replace(
        result,
        T_i_j=said.T_i_j,
        covariance=best.covariance,
        verdict="plausible",
        reasons=(reason, *([told] if told else []), *result.reasons),
        overlap=pair.agreement(said.T_i_j).overlap,
        start=result.start if by_features else OPERATOR,
        grown=True,
        **done,
    )


def _refused(
    result: PairResult, best: OperatorStart, said: Heard, clicks: Clicks, pair: Pair
) -> PairResult:
    """The images contradict every set of clicks: what features say stands without them."""
    order = _other_order(pair, clicks)
    how = order or (f"{said.why}: are these the same places in both images?")
    if said.why.endswith("?") and not order:
        how = said.why
    told = (
        f"your {_points(best)} in {pair.i.name.robot} and {pair.j.name.robot} fit each other, "
        f"but {how}"
    )
    hearing = Hearing((False,) * len(best.inliers), 1.0, told)
    reasons = (*result.reasons, told)
    return replace(result, reasons=reasons, confirmed=False, grown=False, hearing=hearing)


def _has_a_rival(pair: Pair, result: PairResult, best: OperatorStart, said: Heard) -> bool:
    """Whether features found another pose which the images like clearly better, or which is
    verified and which they do not like clearly less.
    """
    found = result.verdict in ("verified", "plausible")
    if not found or result.T_i_j is None or _back(best, result.T_i_j):
        return False
    other = hear(pair, result.T_i_j)
    if result.verdict == "verified":
        better = said.share < CLICKED.much_better * other.share
    else:
        better = said.says != "for" or other.share > CLICKED.much_better * said.share
    return other.says == "for" and better


def _open(result: PairResult, best: OperatorStart, said: Heard, pair: Pair) -> PairResult:
    """Clicks and features lead to two poses: neither joins anything until more is known."""
    told = (
        f"your {_points(best)} in {pair.i.name.robot} and {pair.j.name.robot} fit each other, but "
        f"the images fit another pose as well ({result.inliers} matches): are these the same "
        "places? More points decide"
    )
    return replace(
        result,
        verdict="ambiguous",
        reasons=(told, *result.reasons),
        rivals=(*result.rivals, said.T_i_j),
        confirmed=False,
        grown=False,
        hearing=Hearing((False,) * len(best.inliers), 1.0, told),
    )


def _breaks_the_tie(pair: Pair, result: PairResult, best: OperatorStart, said: Heard) -> bool:
    """Whether clicks decide between poses that the images support alike: they agree with one of
    them, and something that was clicked is not there a second time.
    """
    if not result.rivals or result.T_i_j is None:
        return True
    poses = (result.T_i_j, *result.rivals)
    others = [T for T in poses if not best.suits(T) and not pair.same_pose(T, said.T_i_j)]
    return on_unique_structure(pair, best.pairs[best.inliers], said.T_i_j, others)


def _tied(result: PairResult, best: OperatorStart, said: Heard, pair: Pair) -> PairResult:
    told = (
        f"your {_points(best)} in {pair.i.name.robot} and {pair.j.name.robot} fit, but what you "
        f"clicked exists more than once, and {1 + len(result.rivals)} poses explain the images: "
        "is there something that exists only once?"
    )
    hearing = Hearing((True,) * len(best.inliers), 1.0, told)
    return replace(result, verdict="ambiguous", reasons=(told, *result.reasons), hearing=hearing)


def _other_order(pair: Pair, clicks: Clicks) -> str:
    """The same places in another order, if the images support that."""
    n = len(clicks.z_i)
    for order in list(permutations(range(n)))[1:] if n in (3, 4) else ():
        some = list(order)
        other = replace(
            clicks, uv_j=clicks.uv_j[some], z_j=clicks.z_j[some], sigma_j=clicks.sigma_j[some]
        )
        for one in operator_starts(pair.i, pair.j, other, ()):
            fits = one.covariance is not None and one.alone and one.inliers.all()
            if fits and hear(pair, one.start.T_i_j).says == "for":
                said = ", ".join(f"{k + 1} with {m + 1}" for k, m in enumerate(some))
                return f"the images show them in another order: {said}"
    return ""


def _agreeing(one: OperatorStart, T: Floats) -> tuple[bool, ...]:
    """Which of all clicks agree with a pose."""
    return tuple((one.pairs.distance2(T) < OUTLIER_CHI2).tolist())


def _points(one: OperatorStart) -> str:
    return f"{int(one.inliers.sum())} points"
