"""What pages are told: text frames, made of what is on an operator's desk.

Names and sentences are data; a page shows them as text and nothing else.
"""

import json
import math
from collections.abc import Mapping
from typing import Any, Literal

from fleetpose.hmi_client.cli.why import why_record
from fleetpose.hmi_client.desk import advice
from fleetpose.hmi_client.desk.colours import MARKER_COLOURS
from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.desk.words import describe_cell, plain, sentences
from fleetpose.hmi_client.model.matrix import (
    QUANTITIES,
    are_joined,
    components_of,
    length_text,
    title_of,
)
from fleetpose.hmi_client.model.records import Entry, EntryStatus, PixelUV
from fleetpose.hmi_client.model.top_view import position_sigma_m
from fleetpose.protocol.messages import ViewName
from fleetpose.protocol.text import release

Frame = dict[str, Any]
Tone = Literal["ask", "act", "warn", "done", "wait", "gone"]
SLOW_S = 1.2  # the state comes at 2 to 10 Hz
_WHY_PAIRS = 12
_STATUS: Mapping[EntryStatus, str] = {
    "pending": "pending",
    "erasing": "pending",
    "accepted": "confirmed",
    "outlier": "outlier",
    "unused": "unused",
    "rejected": "rejected",
}


def text_of(frame: Frame) -> str:
    """A frame as it is sent."""
    return json.dumps(frame, separators=(",", ":"), allow_nan=False)


def welcome(
    operator: str, site: str, keymap: KeyMap, settings: Mapping[str, Any], replay: bool
) -> Frame:
    """Who operates where, and what a page needs to draw and to hear keys."""
    return {
        "t": "welcome",
        "v": 1,
        "operator": operator,
        "site": site,
        "version": release(),
        "replay": replay,
        "keymap": keymap.as_json(),
        "colours": {"markers": list(MARKER_COLOURS)},  # those of a page are its style sheet's
        "quantities": [{"id": q, "title": title_of(q, "m")} for q in QUANTITIES],
        "settings": dict(settings),
    }


def notice(text: str, tone: Tone = "warn") -> Frame:
    """A sentence to be shown for a few seconds."""
    return {"t": "notice", "text": text, "tone": tone}


def event(text: str, at_ms: int) -> Frame:
    """Something that happened, and when; milliseconds since 1970."""
    return {"t": "event", "at_ms": at_ms, "text": plain(text), "tone": ""}


def cursor(side: int, pixel: PixelUV) -> Frame:
    """Where a command has put a cursor."""
    return {"t": "cursor", "side": side, "pixel": _px(pixel)}


# ---- the fleet -----------------------------------------------------------------------------------


def names(desk: Desk) -> Frame:
    """The robots in the order of all binary frames, and where the fleet's origin is."""
    fleet = desk.session.fleet
    anchor = None if fleet is None else fleet.anchor
    return {"t": "names", "names": desk.session.robots(), "origin": anchor}


def questions(desk: Desk) -> Frame:
    """What the server asks, the most useful first."""
    fleet = desk.session.fleet
    asked = [
        {"i": q.i, "j": q.j, "gain": q.gain, "why": plain(q.reason)}
        for q in (fleet.questions if fleet else ())
    ]
    return {"t": "questions", "list": asked}


def health(desk: Desk, address: str) -> Frame:
    """Which leg of the connection is broken, and how far the server is with what was done."""
    session = desk.session
    silence_s, known = session.silence_s, session.robots()
    server = "gone" if session.silent else "slow" if silence_s > SLOW_S else "ok"
    return {
        "t": "health",
        "server": server,
        "age_s": None if math.isinf(silence_s) else round(silence_s, 1),
        "kept": session.unconfirmed,
        "leg": "server" if server == "gone" else "",
        "address": address,
        "located": sum(pose.located for pose in session.poses().values()),
        "robots": len(known),
        "confirmed": session.confirmed,
        "unconfirmed": session.unconfirmed,
    }


def why(desk: Desk, robot: str) -> Frame:
    """Why a robot is located or not, and what to do next.

    Raises:
        OperatorError: the fleet has no such robot.
    """
    record = why_record(desk.session, robot, desk.session.alignments(robot))
    reason = record["reason"] or ("" if record["located"] else "the server gives no reason")
    lines = [f"{robot} is {'' if record['located'] else 'not '}located"]
    lines += [plain(reason)] if reason else []
    lines += record["alarms"]
    lines += [_with_other(pair) for pair in record["pairs"][:_WHY_PAIRS]]
    more = max(len(record["pairs"]) - _WHY_PAIRS, 0)
    if more or record["untried"]:
        lines.append(f"{more} more pairs were tried, {record['untried']} never")
    return {"t": "why", "robot": robot, "lines": [*lines, f"next: {record['next']}"]}


def _with_other(pair: Mapping[str, Any]) -> str:
    words = [str(pair["verdict"] or pair["state"]).replace("_", " ")]
    if pair["rmse_m"] is not None:
        words += [length_text(pair["rmse_m"]), f"overlap {100 * pair['overlap']:.0f} %"]
    if pair["alignment"] is not None:
        words += [plain(reason) for reason in pair["alignment"]["reasons"][:2]]
    return f"with {pair['other']}: {', '.join(words)}"


# ---- the selected pair ---------------------------------------------------------------------------


def step(desk: Desk) -> Frame:
    """The one thing to do now."""
    return {"t": "step"} | advice.step(desk).as_json()


def pair(desk: Desk) -> Frame | None:
    """What is known of the selected pair; none without one."""
    session = desk.session
    if session.pair is None:
        return None
    i, j = session.pair
    cell = session.cell(session.pair)
    components = {} if session.fleet is None else components_of(session.fleet)
    return {
        "t": "pair",
        "i": i,
        "j": j,
        "verdict": None if cell is None else cell.verdict,
        "sentence": "; ".join(sentences(describe_cell(session))),
        "sigma_cm": _sigma_cm(desk, i, j),
        "overlap": None if cell is None or cell.state != "tried" else cell.overlap,
        "joined": are_joined(components, i, j),
    }


def _sigma_cm(desk: Desk, i: str, j: str) -> float | None:
    """How unsure the pose of one robot in the other's is at most; none unless both are joined."""
    poses = desk.session.poses()
    a, b = poses.get(i), poses.get(j)
    if a is None or b is None or a.component != b.component:
        return None
    return round(100 * math.hypot(position_sigma_m(a), position_sigma_m(b)), 2)


def points(desk: Desk) -> Frame:
    """The list of the selected pair's points, and what is on its way."""
    session = desk.session
    entries, half = session.entries(), session.half
    seen = desk.view(0), desk.view(1)
    told = [_point(desk, n, entry, seen) for n, entry in enumerate(entries, start=1)]
    if half is not None:
        told.append(_half(desk, len(told) + 1))
    others = session.others().get(session.pair, ()) if session.pair else ()
    undo, redo = session.undoable()
    return {
        "t": "list",
        "pair": None if session.pair is None else list(session.pair),
        "points": told,
        "half": None if half is None else {"side": half.side, "pixel": _px(half.pixel)},
        "frozen": session.frozen,
        "kept": session.unconfirmed,
        "confirmed": session.confirmed,
        "others": list(others),
        "elsewhere": {
            name: list(pair)
            for pair, names in session.others().items()
            for name in names
            if pair != session.pair
        },
        "undo": undo,
        "redo": redo,
        "words": describe_cell(session) if session.pair else "",
        "threshold_m": _metres(session.threshold_m),
    }


def _point(
    desk: Desk, n: int, entry: Entry, seen: tuple[ViewName | None, ViewName | None]
) -> Frame:
    pick = entry.pick
    return {
        "n": n,
        "id": entry.id,
        "status": _STATUS[entry.status],
        "reason": plain(entry.note) or ("being erased" if entry.status == "erasing" else None),
        "pi": _px(pick.pixel_i),
        "pj": _px(pick.pixel_j),
        "residual_m": entry.residual_m,
        "depth_i": _depth(desk, pick.view_i, pick.pixel_i),
        "depth_j": _depth(desk, pick.view_j, pick.pixel_j),
        "by": entry.by or desk.session.operator,
        "other_view": (pick.view_i, pick.view_j) != seen,
    }


def _half(desk: Desk, n: int) -> Frame:
    half = desk.session.half
    assert half is not None
    place: list[list[float] | None] = [None, None]
    depth: list[float | None] = [None, None]
    place[half.side] = _px(half.pixel)
    depth[half.side] = _depth(desk, half.view, half.pixel)
    return {
        "n": n,
        "id": None,
        "status": "half",
        "reason": None,
        "pi": place[0],
        "pj": place[1],
        "residual_m": None,
        "depth_i": depth[0],
        "depth_j": depth[1],
        "by": desk.session.operator,
        "other_view": False,
    }


def assist(desk: Desk) -> Frame:
    """Where to look: the expected other half, a suggestion, labels, the point that does not fit."""
    expected = desk.expected if desk.session.half is not None else None
    proposal, hints = desk.suggestions.current, desk.hints
    shown = {} if hints is None else hints.places
    return {
        "t": "assist",
        "side": desk.side if expected is None else expected.side,
        "expected": None
        if expected is None
        else {
            "pixel": _px(expected.pixel),
            "line": None if expected.segment is None else [_px(p) for p in expected.segment],
            "how": expected.how,
        },
        "suggestion": None
        if proposal is None
        else {
            "n": proposal.number,
            "of": proposal.of,
            "pi": _px(proposal.pixel_i),
            "pj": _px(proposal.pixel_j),
            "depth_i": _metres(desk.depth(0)),
            "depth_j": _metres(desk.depth(1)),
        },
        "hints": [
            {"label": label, "side": desk.side, "pixel": _px(p)} for label, p in shown.items()
        ],
        "wrong": _wrong(desk),
    }


def _wrong(desk: Desk) -> Frame | None:
    wrong = desk.wrong()
    if wrong is None:
        return None
    return {
        "id": wrong.id,
        "side": wrong.side,
        "clicked": _px(wrong.clicked),
        "fits": None if wrong.fits is None else _px(wrong.fits),
        "off_m": _metres(wrong.off_m),
        "off_px": _metres(wrong.off_px),
        "text": advice.wrong_text(wrong),
    }


def _depth(desk: Desk, view: ViewName, pixel: PixelUV) -> float | None:
    lifted = desk.points.at(view, pixel)
    return None if lifted is None else _metres(float(lifted.point[2]))


def _metres(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(float(value), 4)


def _px(pixel: PixelUV) -> list[float]:
    return [round(float(x), 3) for x in pixel]
