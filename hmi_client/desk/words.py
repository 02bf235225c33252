"""What is known, in plain words: of a pair, of points, of what the server confirmed."""

import math
import re
import textwrap
from collections.abc import Mapping
from functools import lru_cache

from fleetpose.hmi_client.model.matrix import are_joined, components_of, doubt_text, length_text
from fleetpose.hmi_client.model.records import Entry, EntryStatus
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import Answer

STATUS_WORDS: dict[EntryStatus, str] = {
    "pending": "on its way",
    "erasing": "going",
    "accepted": "fits",
    "outlier": "off",
    "unused": "not used yet",
    "rejected": "refused",
}
"""What the list says of a point, in a few letters."""

_UNCALIBRATED = (
    re.compile(r"The chance that they show the same is [\d.]+ ?%\.?"),
    re.compile(r"\s*\([\d.e+-]+ m expected\)"),
)
"""What servers tell beside a question or an answer, and nobody has held against what came true."""

_PLAIN = (
    (r"only (\d+) matches agree, need (\d+)", r"only \1 image features agree, \2 are needed"),
    (r"(\d+) feature matches, no five agree", r"of \1 image features no five agree"),
    (
        r"(\d+) matches agree to the pixel, need (\d+)",
        r"\1 image features agree to the pixel, \2 are needed",
    ),
    (
        r"(\d+)% of the moved cloud is seen through",
        r"the other robot sees through \1 % of what should be there",
    ),
    (r"position sigma ([\d.]+)% of the depth", r"the position is unsure by \1 % of the depth"),
    (
        r"(\d+)% of the surfaces would be seen from behind",
        r"\1 % of the surfaces would be seen from behind",
    ),
    (r"three sigma of the position, and what a refit.*", "the position is not sure enough yet"),
    (r"three sigma of the rotation are.*", "the heading is not sure enough yet"),
    (r"a refit moves the pose by ([\d.]+)% of the depth", "the pose moves when it is fitted again"),
    (
        r"(\d+) surface points compared, need (\d+)",
        r"only \1 surface points could be compared, \2 are needed",
    ),
    (r"gravely off with a probability of ([\d.]+)%.*", r"\1 % likely to be gravely off"),
    (r"^(\d+) matches, need (\d+)$", r"only \1 image features are alike, \2 are needed"),
    (r"(\S+) is now in component (\S+) \(was \S+\)", r"\1 is now in the group of \2"),
    (r"\((\d+) correspondences\)", r"(\1 points)"),
    (r"(\d+) matches agree to ([\d.]+) px", r"\1 image features agree to \2 px"),
    (r"correspondence \d+ of \S+, \S+ is not there", "somebody has erased it meanwhile"),
    (r"correspondence \d+ was changed meanwhile: .*", "somebody has moved it meanwhile"),
    (r"not joined to the anchor", "a separate group: not joined to the origin"),
)


_SIGNS = """
Matrix   1.2   point residual of the pair (rms)           bold  the largest of all
         -     above the threshold, or rejected; {hide} and {show} move it
         ~     known only through others                    ·     never tried
         •     points were clicked in this pair               ◂     another operator is there
Map      ● located   ○ not   ─ heading   ⠒ two sigma        separate: a group that is not joined
Image    1 a point that was clicked   1! contradicts the solution   x rejected or being erased
         ◆ the half that was picked   ◇ where its other half is expected, or where the others put it
""".strip("\n")


def signs(names: Mapping[str, str]) -> str:
    """What the signs of all panels mean.

    Args:
        names: of the keys, by the commands' ids.
    """
    return _SIGNS.format(hide=names["hide-more"], show=names["show-more"])


def age_text(seconds: float) -> str:
    """How long ago: now, 12 s ago, 3 min ago, 2 h ago."""
    if seconds < 1:
        return "now"
    if seconds < 100:
        return f"{seconds:.0f} s ago"
    return f"{seconds / 60:.0f} min ago" if seconds < 6000 else f"{seconds / 3600:.0f} h ago"


@lru_cache(1024)  # the same few are told again and again
def plain(reason: str) -> str:
    """A server's reason in plain words, without figures that nobody has calibrated; what no rule
    knows stays as it is.
    """
    for pattern in _UNCALIBRATED:
        reason = pattern.sub("", reason)
    for pattern, words in _PLAIN:
        reason = re.sub(pattern, words, reason)
    return re.sub(r"\s+", " ", reason).strip()


def sentences(text: str) -> list[str]:
    """One thought each: a text cut where its sentences end."""
    parts = re.split(r"(?<=[.?!])\s+|;\s+", text)
    return [part.rstrip(".") for part in parts if part.strip(" .")]


def shortened(text: str, width: int) -> str:
    """As many whole thoughts of a text as there is room for; of one that is too long its words."""
    if len(text) <= width:
        return text
    ends = [found.start() for found in re.finditer(r"[;:.](?=\s)", text)]
    end = max((end for end in ends if end <= width), default=0)
    return text[:end] if end else textwrap.shorten(text, max(width, 1), placeholder=" …")


# ---- of points -----------------------------------------------------------------------------------


def quality(entry: Entry) -> str:
    """Residuals, or why a point was refused."""
    if entry.note:
        return entry.note
    words = []
    if entry.residual_m is not None and entry.status in ("accepted", "outlier"):
        words.append(length_text(entry.residual_m).rjust(8))
    if entry.residual_px is not None and entry.status in ("accepted", "outlier"):
        words.append(f"{entry.residual_px:5.1f} px")
    if entry.by:
        words.append(f"by {entry.by}")
    return " ".join(words)


def count_text(count: int, what: str = "point") -> str:
    """1 point, 2 points."""
    return f"{count} {what}" + ("" if count == 1 else "s")


# ---- of a pair -----------------------------------------------------------------------------------


def describe_cell(session: OperatorSession) -> str:
    """The state of the selected pair in a few words."""
    return ", ".join(facts_of_cell(session))


def facts_of_cell(session: OperatorSession) -> list[str]:
    """The same, each fact alone, the most important first."""
    cell = session.cell(session.pair) if session.pair else None
    if cell is None and session.pair is not None and session.fleet is not None:
        joined = are_joined(components_of(session.fleet), *session.pair)
        return ["known only through others" if joined else "never tried"]
    if cell is None or cell.state == "untried":
        return ["never tried"]
    if cell.state == "through_others":
        return ["known only through others"]
    words = [doubt_text(cell.verdict, cell.p_grave, cell.rivals)]
    if cell.rmse_m and cell.verdict != "rejected":
        words += [
            f"point residual {length_text(cell.rmse_m)}",
            f"overlap {100 * cell.overlap:.0f} %",
        ]
    if session.alignment is not None:
        words.extend(plain(reason) for reason in session.alignment.reasons[:1])
    return words


def answer_of(session: OperatorSession) -> Answer | None:
    """What the clicks in the selected pair did, if they were the last or nearly so."""
    answers = session.fleet.answered if session.fleet else ()
    return next((a for a in reversed(answers) if (a.i, a.j) == session.pair), None)


# ---- of a fleet ----------------------------------------------------------------------------------


def located_text(session: OperatorSession) -> str:
    """How many robots are located."""
    poses, robots = session.poses(), session.robots()
    located = sum(pose.located for pose in poses.values())
    if not robots:
        return "no robot is known yet"
    if located == len(robots):
        return f"all {located} robots are located" if located > 1 else f"{robots[0]} is located"
    return f"{located} of {count_text(len(robots), 'robot')} located"


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


# ---- of what was sent ----------------------------------------------------------------------------


def own_points(session: OperatorSession) -> int:
    """How many points of this operator the server holds."""
    sets = session.sets().values()
    return sum(c.operator == session.operator for known in sets for c in known.items)


def farewell(session: OperatorSession, done: Mapping[str, int]) -> str:
    """A line of what was done, for the end.

    Args:
        session: the operator's.
        done: how often, by the word for it: picked, erased, moved, took back.
    """
    points = count_text(done.get("picked", 0), "point")
    parts = [f"{points} picked" if done.get("picked") else "nothing picked"]
    parts += [f"{done[what]} {what}" for what in ("erased", "moved", "took back") if done.get(what)]
    waiting = session.unconfirmed
    if waiting:
        parts.append(f"{waiting} not confirmed, kept to be sent next time")
    elif done.get("picked"):
        parts.append("all confirmed")
    joined = {r for a in (session.fleet.answered if session.fleet else ()) for r in a.joined}
    parts += [f"{', '.join(sorted(joined))} joined"] if joined and done.get("picked") else []
    return f"{session.operator}: {', '.join(parts)}; {located_text(session)}"


def confirmation(session: OperatorSession) -> str:
    """What the server last confirmed of this operator's work."""
    waiting = session.unconfirmed
    if waiting:
        why = why_unconfirmed(session)
        return f"{waiting} not confirmed yet" + (f": {why}" if why else "")
    points = own_points(session)
    if points:
        return f"{count_text(points)} confirmed"
    return "all confirmed" if session.confirmed else "nothing sent yet"


def why_unconfirmed(session: OperatorSession) -> str:
    """Why updates are not receipted, as far as that can be known: nobody hears them, or a router
    denies them; empty if neither is known.
    """
    if session.silent:
        return "not heard, no server is there"
    denied = session.denied
    return f"denied by the router's rules: {denied[0].what} on {denied[0].key}" if denied else ""
