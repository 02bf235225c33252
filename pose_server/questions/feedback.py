"""What became of the questions: what operators looked at in vain, and what their clicks did."""

from collections.abc import Sequence

import numpy as np

from fleetpose.pose_server.correspondences.store import Outcome
from fleetpose.pose_server.questions.ranking import CLICKS_TO_JOIN, FleetUncertainty, standing
from fleetpose.pose_server.state.question_feedback import Look, Open
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import Answer, Selection

_LOOKED_S = 3.0  # a shorter glance says nothing
_NOTHING_M = 1e-3  # a gain below it is none


def note_selection(site: Site, selection: Selection, now_s: float) -> None:
    """An operator turns to a pair, or away from one: without a click that was in vain."""
    client = (selection.operator, selection.session)
    before = site.feedback.looks.get(client)
    here = _look(site, selection, now_s)
    if before is not None and here is not None and here.keyframes == before.keyframes:
        return
    site.feedback.turn(client, here)
    if before is None or now_s - before.since_s < _LOOKED_S:
        return
    if len(site.correspondences.of(*before.pair)) > before.correspondences:
        return
    site.feedback.note_vain(before.keyframes)


def note_clicks(site: Site, outcomes: Sequence[Outcome]) -> None:
    """New correspondences of a pair open its answer; those of another pair close the one before."""
    for outcome in outcomes:
        if not outcome.accepted or outcome.action != "add":
            continue
        opened = site.feedback.open
        if opened is None or opened.pair != outcome.pair:
            now = _standing(site)
            if now is None:
                continue
            gains = {(q.i, q.j): q.gain for q in site.feedback.asked.questions}
            opened = Open(outcome.pair, gains.get(outcome.pair, 0.0), now)
            site.feedback.begin(opened, _answer(opened, now))
        opened.note_click()


def note_solved(site: Site) -> None:
    """What the clicks of the open pair did so far; an event when it shows."""
    opened, now = site.feedback.open, _standing(site)
    if opened is None or now is None:
        return
    record = site.pair(*opened.pair)
    answer = _answer(opened, now, record.told)
    site.feedback.renew(answer)
    at_work = record.clicks_due or record.running
    if not opened.told and (answer.joined or opened.clicks >= CLICKS_TO_JOIN) and not at_work:
        opened.tell()
        site.say(answer.text)


def _standing(site: Site) -> FleetUncertainty | None:
    newest = site.newest_keyframes()
    if site.solution is None or not newest:
        return None
    depth_m = float(np.median([site.views[view].median_depth_m for view in newest.values()]))
    return standing(site.solution, newest, depth_m, site.anchor)


def _answer(opened: Open, now: FleetUncertainty, told: str = "") -> Answer:
    """What clicks did; `told` is what the images say of them."""
    i, j = opened.pair
    predicted = opened.predicted_m * opened.clicks
    realised = opened.before.mean_sigma_m - now.mean_sigma_m
    joined = tuple(sorted(now.joined - opened.before.joined))
    names = ", ".join(joined[:4]) + (" and others" if len(joined) > 4 else "")
    did = f"joined {names}; " if joined else ""
    points = "1 point" if opened.clicks == 1 else f"{opened.clicks} points"
    by = f"{abs(realised):.2g} m {'worse' if realised < 0 else 'better'}"
    gain = f"the fleet is known {by} on average ({predicted:.2g} m expected)"
    if not joined and abs(realised) < _NOTHING_M:
        gain = "nothing has moved yet"
    return Answer(
        i=i,
        j=j,
        clicks=opened.clicks,
        predicted=predicted,
        realised=realised,
        joined=joined,
        text=f"{points} in {i} and {j}: {did}{gain}" + (f"; {told}" if told else ""),
    )


def _look(site: Site, selection: Selection, now_s: float) -> Look | None:
    views = [view for view in (selection.view_i, selection.view_j) if view is not None]
    here = [at for at in map(site.attached, views) if at is not None]
    if len(here) != 2 or here[0].keyframe.robot == here[1].keyframe.robot:
        return None
    a, b = sorted((at.keyframe for at in here), key=lambda keyframe: keyframe.robot)
    pair = ordered_pair(a.robot, b.robot)
    return Look(pair, (a, b), now_s, len(site.correspondences.of(*pair)))
