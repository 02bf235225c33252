"""What the operator should do now, why, and by which commands. Every face shows these sentences."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from fleetpose.hmi_client.assist.clicked_points import NEAR_PX, NEEDED, Misfit, Wrong, is_live
from fleetpose.hmi_client.desk.state import DeskState as Desk
from fleetpose.hmi_client.desk.state import Tone
from fleetpose.hmi_client.desk.words import (
    answer_of,
    count_text,
    facts_of_cell,
    located_text,
    plain,
    sentences,
)
from fleetpose.hmi_client.model.matrix import length_text
from fleetpose.hmi_client.model.records import Pair
from fleetpose.protocol.messages import Question

SLOW_S = 5.0  # a server that is not heard for less may only be slow
_THERE_PX = 2.0
_LONG_S = 8.0  # an image that is waited for longer than that is worth a reason


@dataclass(frozen=True)
class Action:
    """A button: a command, what is written on it, and how its key is called.

    Attributes:
        do: the command's id.
        label: what it does, in a few words.
        key: the key's name; empty if it needs `args`, which no key gives.
        args: of the command.
        primary: whether it is what one does usually.
    """

    do: str
    label: str
    key: str = ""
    args: Mapping[str, Any] = field(default_factory=dict)
    primary: bool = False


@dataclass(frozen=True)
class Step:
    """One thing to do now.

    Attributes:
        tone: a question, an act, a warning, something done, something waited for, a lost server.
        title: one sentence.
        facts: why it is asked, how sure that is: short sentences.
        actions: at most three.
    """

    tone: Tone
    title: str
    facts: tuple[str, ...] = ()
    actions: tuple[Action, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """For a page."""
        actions = [
            {"do": a.do, "args": dict(a.args), "label": a.label, "key": a.key, "primary": a.primary}
            for a in self.actions
        ]
        return {
            "tone": self.tone,
            "title": self.title,
            "facts": list(self.facts),
            "actions": actions,
        }


def step(desk: Desk) -> Step:
    """The one thing to do now at a desk."""
    if desk.session.silent:
        return _gone(desk)
    if desk.session.pair is None:
        return _unselected(desk)
    pair = desk.session.pair
    return (
        _without_image(desk, pair)
        or _not_kept(desk, pair)
        or _half_picked(desk, pair)
        or _suggested(desk)
        or _refused(desk)
        or _contradicted(desk, pair)
        or _answered(desk, pair)
        or _to_pick(desk, pair)
    )


# ---- without a server, without a pair ------------------------------------------------------------


def _gone(desk: Desk) -> Step:
    session, where = desk.session, f" {desk.where}" if desk.where else ""
    waiting = session.unconfirmed
    kept = f"{count_text(waiting, 'click')} kept, to be sent when it is back"
    facts = (kept,) if waiting else ("clicks are kept until it is back",)
    if math.isinf(session.silence_s):
        return Step("gone", f"NO SERVER heard yet{where}: waiting for one", facts[:waiting])
    since = f"{session.silence_s:.0f} s"
    old = "map, errors and images are of then"
    if session.silence_s < SLOW_S:
        return Step("gone", f"The server{where} is slow: nothing heard for {since}", (old, *facts))
    return Step("gone", f"NO SERVER{where}: nothing heard for {since}", (old, *facts))


def _unselected(desk: Desk) -> Step:
    question = desk.session.question()
    if question is None:
        facts = (located_text(desk.session), "any pair can be chosen in the matrix")
        return Step("done", "Nothing is asked", facts)
    title = f"The best question: {question.i} - {question.j}"
    return Step("ask", title, _why(question), (_act(desk, "next", "go to it", primary=True),))


# ---- images --------------------------------------------------------------------------------------


def _without_image(desk: Desk, pair: Pair) -> Step | None:
    session = desk.session
    if desk.suggestions.waiting:
        return Step("wait", "Fetching the two images of the suggestion", (), (_leave(desk),))
    missing = [robot for robot in pair if session.picture(robot) is None]
    if not missing:
        return None
    go_on = (_act(desk, "next", "next question", primary=True), _act(desk, "why", "why"))
    ended = [robot for robot in missing if not _is_alive(desk, robot)]
    if ended:
        title = f"{' and '.join(ended)} ended: no image comes any more"
        facts = ("start its agent, or answer another question", *_context(desk))
        return Step("warn", title, facts, go_on)
    notices = [notice for robot in missing if (notice := session.picture_notice(robot))]
    if notices:
        title = "; ".join(notices)
        return Step("wait", title[0].upper() + title[1:], _context(desk), go_on)
    title = f"Waiting for the image of {' and '.join(missing)}"
    long = session.seconds_selected > _LONG_S
    facts = (f"asked for it {session.seconds_selected:.0f} s ago",) if long else _context(desk)
    return Step("wait", title, facts, go_on if long else ())


def _is_alive(desk: Desk, robot: str) -> bool:
    robots = desk.session.fleet.robots if desk.session.fleet else ()
    return any(state.robot == robot and state.alive for state in robots)


def _not_kept(desk: Desk, pair: Pair) -> Step | None:
    lost = [robot for robot in pair if desk.session.keeping(robot) == "not kept"]
    if not lost:
        return None
    title = f"The server does not keep this view of {' and '.join(lost)}: pick in a newer one"
    thaw = _act(desk, "freeze", "let the images go on", primary=True)
    return Step("warn", title, ("clicks in it would be refused",), (thaw,))


# ---- picking -------------------------------------------------------------------------------------


def _half_picked(desk: Desk, pair: Pair) -> Step | None:
    half = desk.session.half
    if half is None:
        return None
    done, other = pair if half.side == 0 else pair[::-1]
    title = f"Point picked in {done}: now pick the same point in {other}"
    expected = desk.expected
    facts = () if expected is None else (f"◇ is where it is expected: {expected.how}",)
    actions = (
        _act(desk, "pick", "pick", primary=True),
        _act(desk, "snap", "snap"),
        _act(desk, "cancel", "cancel"),
    )
    return Step("act", title, facts + _progress(desk), actions)


def _suggested(desk: Desk) -> Step | None:
    proposal = desk.suggestions.current
    if proposal is None:
        return None
    title = f"Suggestion {proposal.number} of {proposal.of}: do both crosses show the same point?"
    depths = (desk.depth(0), desk.depth(1))
    facts = [
        f"{'not known how far' if depth is None else length_text(depth)} away in {desk.robot(side)}"
        for side, depth in enumerate(depths)
    ]
    facts = [", ".join(facts)] if any(depth is not None for depth in depths) else []
    if desk.suggestions.dropped:
        facts.append(f"{desk.suggestions.dropped} more contradicted your points by distance")
    actions = (
        _act(desk, "accept", "yes", primary=True),
        _act(desk, "skip", "no"),
        _act(desk, "cancel", "leave"),
    )
    return Step("ask", title, (*_progress(desk), *facts, *_context(desk)), actions)


def _to_pick(desk: Desk, pair: Pair) -> Step:
    i, j = pair
    question = _question(desk)
    facts = _progress(desk) + _context(desk)
    by_hand = (_act(desk, "go", "go to what stands out"), _act(desk, "pick", "pick"))
    refused, points = desk.suggestions.refused == pair, any(map(is_live, desk.session.entries()))
    if refused and not points:
        title = f"None of the suggestions shows the same in {i} and {j}"
        go_on = _act(desk, "next", "next question", primary=True)
        return Step("ask", title, facts, (go_on, *by_hand))
    if question is not None and question.suggestions and not refused:
        shows = _act(desk, "accept", "show suggestions", primary=True)
        return Step("ask", f"Where do {i} and {j} see the same point?", facts, (shows, *by_hand))
    title = f"Pick the same point in {i} and in {j}"
    if question is None and desk.session.question() and not desk.session.entries():
        go_on = _act(desk, "next", "next question", primary=True)
        return Step("ask", title, ("nothing is asked about them", *facts), (go_on, *by_hand))
    snap = _act(desk, "snap", "snap")
    first = _act(desk, "pick", "pick", primary=True)
    return Step("ask", title, facts, (by_hand[0], snap, first))


def _progress(desk: Desk) -> tuple[str, ...]:
    """How many points there are, and what they lack."""
    entries = desk.session.entries()
    live = [entry for entry in entries if is_live(entry)]
    facts = [f"{len(live)} of {NEEDED} points"] if 0 < len(live) < NEEDED else []
    near = desk.points.near(entries)
    if near is not None:
        facts.append(f"{near[0]} and {near[1]} are within {NEAR_PX:.0f} px: pick farther apart")
    if desk.points.on_one_line(entries):
        which = "these three" if len(live) == NEEDED else f"these {len(live)}"
        facts.append(f"{which} lie on one line: pick one to the side")
    return tuple(facts)


# ---- what came of it -----------------------------------------------------------------------------


def _refused(desk: Desk) -> Step | None:
    """A point that the server did not take."""
    entries = desk.session.entries()
    refused = [(n, e) for n, e in enumerate(entries, start=1) if e.status == "rejected"]
    if not refused:
        return None
    number, entry = refused[-1]
    actions = (_act(desk, "pick", "pick another", primary=True), _act(desk, "cancel", "clear it"))
    title = f"Point {number} was refused: {plain(entry.note)}"
    return Step("warn", title, _progress(desk) + _context(desk), actions)


def _contradicted(desk: Desk, pair: Pair) -> Step | None:
    entries = desk.session.entries()
    wrong = desk.wrong()
    if wrong is not None:
        facts = _how_to_mend(desk, wrong) + _context(desk)
        return Step("warn", wrong_text(wrong), facts, _mend(desk, wrong))
    misfits = desk.points.misfits(entries)
    if not misfits:
        return None
    worst = max(misfits, key=lambda m: abs(m.in_i_m - m.in_j_m))
    newest = entries[worst.b - 1]
    actions = (_act(desk, "undo", "take it back"),)
    if newest.id is not None:
        actions = (_on_point(desk, "erase", f"erase {worst.b}", newest.id),)
    more = _act(desk, "pick", "pick another", primary=True)
    facts = _progress(desk) + _context(desk)
    return Step("warn", misfit_text(worst, pair), facts, (*actions, more))


def wrong_text(wrong: Wrong) -> str:
    """That a point contradicts the others, and by how much."""
    off = "" if wrong.off_m is None else f": {length_text(wrong.off_m)} off"
    return f"Point {wrong.number} does not fit the others{off}"


def misfit_text(misfit: Misfit, pair: Pair) -> str:
    """That two points are not as far apart in one image as in the other."""
    in_i, in_j = length_text(misfit.in_i_m), length_text(misfit.in_j_m)
    return f"{misfit.a} and {misfit.b} do not fit: {in_i} apart in {pair[0]}, {in_j} in {pair[1]}"


def _is_there(wrong: Wrong) -> bool:
    """Whether a point lies where the others put it, so that moving it there mends nothing."""
    return wrong.off_px is not None and wrong.off_px < _THERE_PX


def _how_to_mend(desk: Desk, wrong: Wrong) -> tuple[str, ...]:
    """What to compare before a point is moved or erased."""
    if wrong.fits is None or not desk.shows(wrong.id):
        return ()
    if _is_there(wrong):
        return ("it is where the others put it, but hidden there or without a good depth",)
    here, there = desk.robot(wrong.side), desk.robot(1 - wrong.side)
    return (
        f"in {here} the others put it at ◇",
        f"if ◇ shows the same as {there}, move it there, else erase it",
    )


def _mend(desk: Desk, wrong: Wrong) -> tuple[Action, ...]:
    erase = _on_point(desk, "erase", f"erase {wrong.number}", wrong.id)
    if not desk.shows(wrong.id):
        return _act(desk, "look", "show it", primary=True), erase
    if wrong.fits is None or _is_there(wrong):
        move = _on_point(desk, "move", "move it to the cursor", wrong.id)
        return move, replace(erase, primary=True)
    to = {"side": wrong.side, "pixel": list(wrong.fits)}
    move = _on_point(desk, "move", "move it to ◇", wrong.id, **to)
    return replace(move, primary=True), erase


def _answered(desk: Desk, pair: Pair) -> Step | None:
    answer, session = answer_of(desk.session), desk.session
    if answer is None or not answer.clicks or _question(desk) is not None:
        return None
    points = sum(is_live(entry) for entry in session.entries())
    if not answer.joined and points < NEEDED:
        return None
    waiting = session.question() is not None
    rest = "" if waiting else "; nothing else is asked"
    did = f"{', '.join(answer.joined[:4])} joined" if answer.joined else "Answered"
    facts = (f"{count_text(points)} in {pair[0]} and {pair[1]}", *_context(desk))
    actions = (_act(desk, "next", "next question", primary=True),) if waiting else ()
    return Step("done", f"{did}: {located_text(session)}{rest}", facts, actions)


# ---- why -----------------------------------------------------------------------------------------


def _question(desk: Desk) -> Question | None:
    """The question about the selected pair."""
    question = desk.session.question()
    asked = question is not None and (question.i, question.j) == desk.session.pair
    return question if asked else None


def _why(question: Question) -> tuple[str, ...]:
    first, *rest = sentences(plain(question.reason)) or [""]
    return (*((f"asked: {first}",) if first else ()), *rest)


def _context(desk: Desk) -> tuple[str, ...]:
    """Who else is here, why it is asked, what is known about the pair."""
    session, question = desk.session, _question(desk)
    others = session.others().get(session.pair, ()) if session.pair else ()
    here = (f"{' and '.join(others)} {'is' if len(others) == 1 else 'are'} here too",)
    asked = () if question is None else _why(question)
    points = sum(is_live(entry) for entry in session.entries())
    cell = session.cell(session.pair) if session.pair else None
    if question is not None and points >= NEEDED and cell and cell.verdict != "verified":
        asked = (f"{count_text(points)} clicked, not confirmed by the images yet", *asked)
    return (*(here if others else ()), *asked, *facts_of_cell(session))


def _act(desk: Desk, do: str, label: str, primary: bool = False, **args: Any) -> Action:
    return Action(do, label, desk.names.get(do, ""), args, primary)


def _on_point(desk: Desk, do: str, label: str, id: int, **args: Any) -> Action:
    """A command for a point: with its key where that, by the cursor, means the same point."""
    nearest = desk.nearest(desk.side)
    key = desk.names.get(do, "") if nearest is not None and nearest.id == id else ""
    return Action(do, label, key, {"id": id} | args)


def _leave(desk: Desk) -> Action:
    return _act(desk, "cancel", "leave")
