"""What the operator should do next and why, in sentences. Every client shows these."""

import math
from collections.abc import Mapping

from fleetpose.hmi_client.assist.suggestions import Suggestions
from fleetpose.hmi_client.model.matrix import are_joined, components_of, doubt_text, length_text
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import Answer


def next_step(session: OperatorSession, proposals: Suggestions, keys: Mapping[str, str]) -> str:
    """The one thing to do now.

    Args:
        session: the operator's.
        proposals: the suggestions.
        keys: how the keys of the commands are called, by the commands' ids.
    """
    if session.silent:
        if math.isinf(session.silence_s):
            return "NO SERVER heard yet; waiting for one"
        since = f"{session.silence_s:.0f} s"
        return f"NO SERVER: nothing heard for {since}. What is shown is old; clicks are kept."
    question = session.question()
    if session.pair is None:
        if question is None:
            select = f"Arrows and {keys['select']} in the matrix select any pair."
            return f"Nothing is asked. {select}"
        return f"Press {keys['next']} for the best question: {question.i} - {question.j}"
    i, j = session.pair
    missing = [robot for robot in (i, j) if session.picture(robot) is None]
    if missing:
        notices = [notice for robot in missing if (notice := session.picture_notice(robot))]
        if notices:
            return "; ".join(notices)
        return f"Waiting for the image of {' and '.join(missing)} ..."
    lost = [robot for robot in (i, j) if session.keeping(robot) == "not kept"]
    if lost:
        thaw = f"{keys['freeze']} thaws, pick anew"
        return f"The server does not keep this view of {' and '.join(lost)}: {thaw}"
    if proposals.waiting:
        return "Fetching the two images of the suggestion ..."
    proposal = proposals.current
    if proposal is not None:
        return (
            f"Suggestion {proposal.number} of {proposal.of}: do both crosses show the same point? "
            f"{keys['accept']} yes, {keys['skip']} no, arrows correct, {keys['cancel']} leaves"
        )
    if session.half is not None:
        done, other = (i, j) if session.half.side == 0 else (j, i)
        return (
            f"Point picked in {done}: now pick the same point in {other} ({keys['cancel']} cancels)"
        )
    go, picks = keys["go"], f"{keys['snap']} snaps, {keys['pick']} picks"
    question = session.question()
    asked = question is not None and (question.i, question.j) == session.pair
    answer = answer_of(session)
    if answer is not None and not asked and answer.clicks:
        more = f"{keys['next']} goes to the next question"
        rest = more if question is not None else "nothing else is asked"
        done = f"{', '.join(answer.joined[:4])} joined" if answer.joined else "Answered"
        return f"{done}: {located_text(session)}; {rest}"
    if question is not None and asked and question.suggestions:
        shows = f"{keys['accept']} shows suggestions"
        return f"Same point in {i} and {j}? {shows}; or {go}, arrows, {picks}"
    return f"Pick the same point in {i} and in {j}: {go} or arrows go, {picks}"


def reason(session: OperatorSession) -> str:
    """Why the question is asked, or what is known about the selected pair."""
    question, cell = session.question(), None
    if session.pair is not None:
        cell = session.cell(session.pair)
    asked = question is not None and (session.pair in (None, (question.i, question.j)))
    parts = []
    others = session.others().get(session.pair, ()) if session.pair else ()
    if others:
        parts.append(f"{' and '.join(others)} {'is' if len(others) == 1 else 'are'} here too")
    answer = answer_of(session)
    if answer is not None:
        parts.append(f"Done: {answer.text}")
    if question is not None and asked:
        gain = f" (a click gains about {length_text(question.gain)})" if question.gain else ""
        parts.append(f"Asked: {question.reason}{gain}")
    if session.pair is not None and (cell is not None or session.fleet is not None):
        parts.append(describe_cell(session))
    return "  ·  ".join(parts)


def answer_of(session: OperatorSession) -> Answer | None:
    """What the clicks in the selected pair did, if they were the last or nearly so."""
    answers = session.fleet.answered if session.fleet else ()
    return next((a for a in reversed(answers) if (a.i, a.j) == session.pair), None)


def located_text(session: OperatorSession) -> str:
    """How many robots are located."""
    poses, robots = session.poses(), session.robots()
    located = sum(pose.located for pose in poses.values())
    if located == len(robots):
        return f"all {located} robots are located"
    return f"{located} of {len(robots)} robots are located"


def site_text(session: OperatorSession) -> str:
    """How a site is, in a few words, for an operator who looks at another one."""
    if session.silent:
        never = math.isinf(session.silence_s)
        parts = ["no server yet" if never else f"NO SERVER for {session.silence_s:.0f} s"]
    else:
        located = sum(pose.located for pose in session.poses().values())
        parts = [f"{located}/{len(session.robots())} located"]
        if session.fleet is not None and session.fleet.questions:
            parts.append("a question waits")
    if session.unconfirmed:
        parts.append(f"{session.unconfirmed} not confirmed")
    return ", ".join(parts)


def describe_cell(session: OperatorSession) -> str:
    """The state of the selected pair in a few words."""
    cell = session.cell(session.pair) if session.pair else None
    if cell is None and session.pair is not None and session.fleet is not None:
        joined = are_joined(components_of(session.fleet), *session.pair)
        return "known only through others" if joined else "never tried"
    if cell is None or cell.state == "untried":
        return "never tried"
    if cell.state == "through_others":
        return "known only through others"
    words = [doubt_text(cell.verdict, cell.p_grave, cell.rivals)]
    if cell.rmse_m is not None:
        words += [length_text(cell.rmse_m), f"overlap {100 * cell.overlap:.0f} %"]
    if session.alignment is not None:
        words.append(f"{session.alignment.inliers} inliers from {session.alignment.start}")
        words.extend(session.alignment.reasons[:1])
    return ", ".join(words)


def confirmation(session: OperatorSession) -> str:
    """What the server last confirmed of this operator's work."""
    waiting, confirmed = session.unconfirmed, session.confirmed
    if waiting:
        why = why_unconfirmed(session)
        return f"{waiting} not confirmed yet" + (f": {why}" if why else "")
    return f"all {confirmed} confirmed" if confirmed else "nothing sent yet"


def why_unconfirmed(session: OperatorSession) -> str:
    """Why updates are not receipted, as far as that can be known: nobody hears them, or a router
    denies them; empty if neither is known.
    """
    if session.silent:
        return "not heard, no server is there"
    denied = session.denied
    return f"denied by the router's rules: {denied[0].what} on {denied[0].key}" if denied else ""
