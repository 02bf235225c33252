"""What the commands print: tables and lines from the session, as text or JSON."""

import json
import math
import shutil
import sys
import textwrap
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from fleetpose.hmi_client.desk.words import plain
from fleetpose.hmi_client.model.matrix import doubt_text, length_text
from fleetpose.hmi_client.model.records import Entry, Pair
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.model.top_view import heading_rad, position, position_sigma_m
from fleetpose.protocol.messages import PairCell, RobotPose, ServerStatus

Record = dict[str, Any]
LOOK_S = 0.5  # all sites are looked at so often, if nothing comes before
_DOUBTFUL = 5  # pairs that the status names
_DENIALS = 3  # kinds of denials of one name


def table(head: Sequence[str], rows: Iterable[Sequence[str]], columns: int | None = None) -> str:
    """Left-aligned columns, as wide as they need; where that is more than so many columns, each row
    is a paragraph instead, whose cells begin with what they are.
    """
    lines = [tuple(head), *(tuple(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    if columns is not None and sum(widths) + 2 * (len(head) - 1) > columns:
        return "\n".join(_paragraph(head, row, columns) for row in lines[1:])
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def _paragraph(head: Sequence[str], row: Sequence[str], columns: int) -> str:
    first, *cells = (f"{name} {cell}".strip() for name, cell in zip(head, row, strict=True) if cell)
    text = f"{first}: {'; '.join(cells)}"
    return textwrap.fill(text, max(columns, 20), subsequent_indent="    ")


def terminal_columns() -> int | None:
    """How wide the terminal is; none where the output goes elsewhere and is not to be wrapped."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def pose_record(pose: RobotPose) -> Record:
    """Position in metres in the fleet frame, heading in degrees, sigma of the position."""
    x, y, z = (round(float(value), 3) for value in position(pose))
    return {
        "type": "pose",
        "robot": pose.robot,
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "heading_deg": round(math.degrees(heading_rad(pose)), 1),
        "sigma_m": round(position_sigma_m(pose), 3),
        "verdict": pose.verdict,
        "located": pose.located,
        "component": pose.component,
    }


def pair_record(cell: PairCell) -> Record:
    """The last error of a pair; `rmse_m` is none where it is not known or the last try failed."""
    return {
        "type": "pair",
        "i": cell.i,
        "j": cell.j,
        "state": cell.state,
        "verdict": cell.verdict,
        "rmse_m": None if cell.rmse_m is None else round(cell.rmse_m, 4),
        "p_grave": None if cell.p_grave is None else round(cell.p_grave, 3),
        "rivals": cell.rivals,
        "correspondences": cell.correspondences,
    }


def sentence(record: Record) -> str:
    """A record as a line of text."""
    r = record
    if r["type"] == "pose":
        located = "located" if r["located"] else f"not located (separate group of {r['component']})"
        return (
            f"pose  {r['robot']:<8} x {r['x_m']:+9.3f}  y {r['y_m']:+9.3f}  z {r['z_m']:+9.3f} m"
            f"  heading {r['heading_deg']:+7.1f} deg  sigma {r['sigma_m']:.3f} m"
            f"  {r['verdict']:<9}  {located}"
        )
    if r["type"] == "pair":
        error = length_text(r["rmse_m"]) if r["rmse_m"] and r["verdict"] != "rejected" else "-"
        state = r["state"].replace("_", " ")
        if r["state"] == "tried":
            state = doubt_text(r["verdict"], r["p_grave"], r["rivals"])
        return f"pair  {r['i']} - {r['j']}  {error}  {state}  {r['correspondences']} clicked"
    if r["type"] == "question":
        return f"asked {r['i']} - {r['j']}  {r['reason']}"
    if r["type"] == "drops":
        reasons = ", ".join(f"{reason} {n}" for reason, n in sorted(r["by_reason"].items()))
        return f"drops {r['total']} in all: {reasons}"
    return f"{r['type']:<5} {r['text']}"


class Watcher:
    """Tells what has changed in a session since it was last asked."""

    def __init__(self, session: OperatorSession) -> None:
        self._session = session
        self._told: dict[tuple[str, ...], Record] = {}
        self._events_told = 0
        self._silent = False
        self._dropped = 0
        self._asked: set[Pair] = set()

    def news(self) -> list[Record]:
        """Records that are new or differ from what was told."""
        session = self._session
        records = [pose_record(pose) for _, pose in sorted(session.poses().items())]
        records += [pair_record(c) for c in (session.fleet.pairs if session.fleet else ())]
        news = []
        for record in records:
            name = (record["type"], *(str(record.get(k, "")) for k in ("robot", "i", "j")))
            if record["type"] == "pair" and record["state"] == "untried":
                continue
            if self._told.get(name) != record:
                self._told[name] = record
                news.append(record)
        return news + self._questions() + self._events() + self._silence() + self._drops()

    def _questions(self) -> list[Record]:
        """What is asked that was not before."""
        questions = self._session.fleet.questions if self._session.fleet else ()
        before, self._asked = self._asked, {(q.i, q.j) for q in questions}
        return [
            {"type": "question", "i": q.i, "j": q.j, "reason": plain(q.reason)}
            for q in questions
            if (q.i, q.j) not in before
        ]

    def _events(self) -> list[Record]:
        events, told = self._session.events_since(self._events_told)
        self._events_told = told
        return [{"type": "event", "text": plain(text)} for text in events]

    def _drops(self) -> list[Record]:
        counts = self._session.drops.snapshot()
        total = sum(counts.values())
        if total == self._dropped:
            return []
        self._dropped = total
        return [{"type": "drops", "total": total, "by_reason": counts}]

    def _silence(self) -> list[Record]:
        silent = self._session.silent
        changed, self._silent = silent != self._silent, silent
        if not changed:
            return []
        text = "nothing heard from the server" if silent else "the server is heard again"
        return [{"type": "event", "text": text}]


def watching(
    sites: Mapping[str, OperatorSession], as_json: bool, end: float | None
) -> Iterator[str]:
    """Lines of what is new, as it comes, each with its time of day; of several sites each begins
    with, or holds, its site.

    Args:
        sites: the sessions by the names of their sites.
        as_json: lines of JSON.
        end: when to stop, monotonic seconds; none: never.
    """
    watchers = {site: Watcher(session) for site, session in sites.items()}
    several = len(sites) > 1
    while end is None or time.monotonic() < end:
        for site, session in sites.items():
            seen = session.revisions()
            for record in watchers[site].news():
                now = datetime.now()
                named = {"site": site} | record if several else record
                said = f"{site}: {sentence(record)}" if several else sentence(record)
                at = {"at": now.astimezone().isoformat(timespec="milliseconds")}
                yield json.dumps(named | at) if as_json else f"{now:%H:%M:%S} {said}"
            left = LOOK_S if end is None else min(LOOK_S, max(end - time.monotonic(), 0.0))
            session.wait_change(seen, ("poses", "fleet", "events"), left / len(sites))


def _inside(status: ServerStatus) -> str:
    """What waits in the server, what takes its time, what it picked last: lines of their own."""
    waiting = ", ".join(f"{n} {line}" for line, n in status.waiting.items() if n)
    stages = ", ".join(f"{stage} {ms:.1f}" for stage, ms in status.stage_ms.items())
    lines = [
        f"waiting: {waiting or 'nothing'}; longest wait {status.wait_share:.0%} of its bound",
        f"median ms: {stages or 'nothing yet'}",
        f"picked last: {status.picked}" if status.picked else "",
    ]
    return "".join(f"\n{line}" for line in lines + _at_the_routers(status) if line)


def _at_the_routers(status: ServerStatus) -> list[str]:
    """What routers deny to whom, and whom they do not let in."""
    by_name: dict[str, list[str]] = {}
    for one in status.denied:
        by_name.setdefault(one.who, []).append(f"{one.what} on {one.key} {one.n}")
    lines = [
        f"denied to {who}: {', '.join(what[:_DENIALS])}"
        + (f" and {len(what) - _DENIALS} more kinds" if len(what) > _DENIALS else "")
        for who, what in by_name.items()
    ]
    turned_away = ", ".join(f"{cause} {n}" for cause, n in sorted(status.refused.items()))
    return lines + ([f"turned away: {turned_away}"] if turned_away else [])


def status_text(session: OperatorSession, columns: int | None = None) -> str:
    """The server, its robots and its questions; tables at most so many columns wide."""
    parts = []
    status = session.status
    if status is not None:
        drops = ", ".join(f"{reason} {n}" for reason, n in sorted(status.drops.items()) if n)
        parts.append(
            f"server {status.version}, up {status.uptime_s:.0f} s, {status.workers} workers: "
            f"{status.views} views, {status.alignments} alignments ({status.pairs_per_s:.1f}/s), "
            f"{status.solves} solves, {status.pending_jobs} pending, "
            f"longest wait {status.max_pair_wait_s:.1f} s, dropped: {drops or 'nothing'}"
            + _inside(status)
        )
    parts += other_versions(session)
    rows = [robot_row(session, robot) for robot in session.robots()]
    located = sum(row[1] == "yes" for row in rows)
    anchor = session.fleet.anchor if session.fleet else None
    parts.append(f"{located} of {len(rows)} robots located, origin {anchor or 'none'}")
    if rows:
        head = ("robot", "located", "x m", "y m", "z m", "heading", "sigma", "why not")
        parts.append(table(head, rows, columns))
    doubtful = doubtful_rows(session)
    if doubtful:
        parts.append(
            table(("pair", "error", "tried", "most likely to be wrong"), doubtful, columns)
        )
    alarms = session.fleet.alarms if session.fleet else ()
    if alarms:
        parts.append("\n".join(f"alarm: {alarm.robot}: {alarm.text}" for alarm in alarms))
    questions = session.fleet.questions if session.fleet else ()
    asked = [(str(k), f"{q.i} - {q.j}", plain(q.reason)) for k, q in enumerate(questions, start=1)]
    if asked:
        parts.append(table(("question", "pair", "reason"), asked, columns))
    else:
        parts.append("no questions")
    return "\n\n".join(parts)


def other_versions(session: OperatorSession) -> list[str]:
    """That robots run other versions than the server, in a sentence; empty if none does."""
    if session.status is None:
        return []
    alive = (robot for robot in session.robots() if session.robot(robot).alive)
    versions = {robot: session.versions[robot] for robot in alive if robot in session.versions}
    others = [
        f"{robot} {version or 'an older one'}"
        for robot, version in versions.items()
        if version != session.status.version
    ]
    told = f"not of the server's version {session.status.version}: {', '.join(others)}"
    return [told] if others else []


def doubtful_rows(session: OperatorSession) -> list[tuple[str, ...]]:
    """The pairs that count and that are most likely gravely off, the likeliest first."""
    cells = session.fleet.pairs if session.fleet else ()
    known = [(c.p_grave, c) for c in cells if c.p_grave is not None and c.verdict != "rejected"]
    known.sort(key=lambda one: -one[0])
    return [
        (
            f"{c.i} - {c.j}",
            "-" if c.rmse_m is None else length_text(c.rmse_m),
            f"{c.age_s:.0f} s ago",
            doubt_text(c.verdict, c.p_grave, c.rivals),
        )
        for _, c in known[:_DOUBTFUL]
    ]


def robot_row(session: OperatorSession, robot: str) -> tuple[str, ...]:
    """One line of the table of robots."""
    state, pose = session.robot(robot), session.poses().get(robot)
    why = state.why_not if state.alive else f"not alive; {state.why_not}".rstrip("; ")
    if pose is None:
        return (robot, "no", "", "", "", "", "", why)
    x, y, z = (f"{value:+.3f}" for value in position(pose))
    heading = f"{math.degrees(heading_rad(pose)):+.1f} deg"
    sigma = length_text(position_sigma_m(pose))
    return (robot, "yes" if pose.located else "no", x, y, z, heading, sigma, why)


def entries_text(pair: Pair, entries: Sequence[Entry]) -> str:
    """The correspondences of a pair."""
    rows = [
        (
            "" if entry.id is None else str(entry.id),
            entry.status,
            f"{entry.pick.pixel_i[0]:.1f}, {entry.pick.pixel_i[1]:.1f}",
            f"{entry.pick.pixel_j[0]:.1f}, {entry.pick.pixel_j[1]:.1f}",
            "" if entry.residual_m is None else length_text(entry.residual_m),
            "" if entry.residual_px is None else f"{entry.residual_px:.1f} px",
        )
        for entry in entries
    ]
    head = ("id", "status", f"pixel in {pair[0]}", f"pixel in {pair[1]}", "residual", "")
    return table(head, rows)
