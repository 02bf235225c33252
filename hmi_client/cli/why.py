"""Why a robot is located or not: everything the server has told about it, and what to do next."""

from collections import Counter
from collections.abc import Mapping

from fleetpose.hmi_client.cli.reports import Record, pose_record, table
from fleetpose.hmi_client.desk.words import plain
from fleetpose.hmi_client.model.matrix import doubt_text, length_text
from fleetpose.hmi_client.model.records import Pair
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import Alarm, Alignment, PairCell

BEST_FIRST = ("verified", "plausible", "ambiguous", "rejected", None)
SHOWN_PAIRS = 12
CLICKS_HELP = {"lost", "carried"}
"""Kinds of alarms: clicks tell where a robot is that sees nothing known, and mend no camera."""


def tried_pairs(session: OperatorSession, robot: str) -> list[Pair]:
    """The pairs of a robot that have been aligned, whatever came of it."""
    cells = session.fleet.pairs if session.fleet else ()
    return [(c.i, c.j) for c in cells if robot in (c.i, c.j) and c.state == "tried"]


def why_record(
    session: OperatorSession, robot: str, alignments: Mapping[Pair, Alignment]
) -> Record:
    """What is known about a robot; what is not known is none.

    Args:
        session: that has heard the server.
        robot: its name.
        alignments: the newest ones of its pairs, as far as heard.

    Raises:
        OperatorError: the fleet has no such robot.
    """
    state, pose = session.robot(robot), session.poses().get(robot)
    cells = [c for c in (session.fleet.pairs if session.fleet else ()) if robot in (c.i, c.j)]
    cells.sort(key=lambda c: (BEST_FIRST.index(c.verdict), c.rmse_m is None, c.rmse_m or 0.0))
    known = [c for c in cells if c.state != "untried" or c.correspondences]
    newest = state.newest_view
    record: Record = {
        "robot": robot,
        "located": pose is not None and pose.located and not state.why_not,
        "reason": state.why_not,
        "alive": state.alive,
        "newest_view": None if newest is None else str(newest),
        "newest_view_age_s": pose.age_s if pose is not None and pose.view == newest else None,
        "views_kept": state.views_kept,
        "pose": None if pose is None else pose_record(pose),
        "pose_view": None if pose is None else str(pose.view),
        "pose_age_s": None if pose is None else pose.age_s,
        "pairs": [pair_of(session, robot, c, alignments.get((c.i, c.j))) for c in known],
        "untried": len(session.robots()) - 1 - len(known),
        "question": question_of(session, robot),
        "alarms": [alarm.text for alarm in alarms_of(session, robot)],
        "alarm_kinds": [alarm.kind for alarm in alarms_of(session, robot)],
    }
    return record | {"next": next_for(record)}


def pair_of(
    session: OperatorSession, robot: str, cell: PairCell, alignment: Alignment | None
) -> Record:
    """A pair of a robot: its newest alignment, what is held of it, and its correspondences."""
    sets = session.sets().get((cell.i, cell.j))
    clicked = Counter(c.status for c in sets.items) if sets else Counter()
    return {
        "other": cell.j if cell.i == robot else cell.i,
        "state": cell.state,
        "verdict": cell.verdict,
        "rmse_m": cell.rmse_m,
        "p_grave": cell.p_grave,
        "rivals": cell.rivals,
        "overlap": cell.overlap,
        "age_s": cell.age_s,
        "correspondences": dict(sorted(clicked.items())) if sets else cell.correspondences,
        "alignment": None
        if alignment is None
        else {
            "views": [str(alignment.view_i), str(alignment.view_j)],
            "verdict": alignment.verdict,
            "start": alignment.start,
            "inliers": alignment.inliers,
            "reasons": list(alignment.reasons),
        },
    }


def alarms_of(session: OperatorSession, robot: str) -> list[Alarm]:
    """What the server says of what is wrong with a robot."""
    return [a for a in (session.fleet.alarms if session.fleet else ()) if a.robot == robot]


def question_of(session: OperatorSession, robot: str) -> Record | None:
    """The server's best question that concerns a robot, and its rank."""
    questions = session.fleet.questions if session.fleet else ()
    for rank, q in enumerate(questions, start=1):
        if robot in (q.i, q.j):
            return {"rank": rank, "i": q.i, "j": q.j, "reason": q.reason, "gain_m": q.gain}
    return None


def next_for(record: Record) -> str:
    """What to do next, in a sentence."""
    robot, question = record["robot"], record["question"]
    if not record["alive"]:
        return f"start its agent, or check its network: robot-agent run --name {robot} ..."
    if record["newest_view"] is None:
        if "refused" in record["reason"]:
            return "mend what its views are refused for: the server takes none of them"
        return "check that its camera runs and that it may publish under its name"
    if not CLICKS_HELP.issuperset(record["alarm_kinds"]):
        return "do what its alarm says first: clicks do not make up for it"
    outliers = [pair["other"] for pair in record["pairs"] if _outliers(pair)]
    if outliers and not record["located"]:
        i, j = ordered_pair(robot, outliers[0])
        return (
            f"{_outliers_of(record, outliers[0])} of the points clicked in {i} and {j} contradict "
            f"the solution: look at them with 'hmi-client correspondences list {i} {j}', erase "
            "the wrong ones"
        )
    if question is not None:
        i, j = question["i"], question["j"]
        can = "to make it surer, click" if record["located"] else "click"
        return (
            f"{can} the same points in the images of {i} and {j}: 'hmi-client', then n, or "
            f"'hmi-client correspondences add {i} {j} U1,V1,U2,V2'"
        )
    if record["located"]:
        return "nothing: it is located"
    if not record["pairs"]:
        return "wait: none of its pairs has been tried yet"
    return (
        "nothing is asked while the server still tries by itself: wait, turn the robot to what "
        "another one sees, or choose a pair that sees the same in 'hmi-client' and click there"
    )


def why_text(record: Record, columns: int | None = None) -> str:
    """The same for reading; its table is at most so many columns wide."""
    robot = record["robot"]
    verdict = "is located" if record["located"] else "is not located"
    reason = record["reason"] or ("" if record["located"] else "the server gives no reason")
    parts = [f"{robot} {verdict}" + (f": {reason}" if reason else "")]
    parts += [f"alarm: {text}" for text in record["alarms"]]
    parts.append(_presence(record))
    rows = [_row(pair) for pair in record["pairs"][:SHOWN_PAIRS]]
    if rows:
        head = (
            "with",
            "verdict",
            "point residual",
            "overlap",
            "tried",
            "clicked",
            "newest alignment",
        )
        parts.append(table(head, rows, columns))
    more = max(0, len(record["pairs"]) - SHOWN_PAIRS)
    if more or record["untried"]:
        parts.append(f"{more} more pairs were tried, {record['untried']} never")
    question = record["question"]
    if question is not None:
        parts.append(
            f"question {question['rank']}: {question['i']} - {question['j']}: "
            f"{plain(question['reason'])}"
        )
    parts.append(f"next: {record['next']}")
    return "\n".join(parts)


def _presence(record: Record) -> str:
    words = ["alive" if record["alive"] else "not alive"]
    age = record["newest_view_age_s"]
    if record["newest_view"] is None:
        words.append("no view has arrived")
    else:
        words.append(f"newest view {record['newest_view']}" + (f", {age:.1f} s old" if age else ""))
        words.append(f"{record['views_kept']} views kept")
    pose = record["pose"]
    if pose is None:
        words.append("no pose")
    else:
        old = "" if record["pose_view"] == record["newest_view"] else f" of {record['pose_view']}"
        words.append(
            f"pose{old} {record['pose_age_s']:.1f} s old, {pose['verdict']}, sigma "
            f"{length_text(pose['sigma_m'])}, in the group of {pose['component']}"
        )
    return "; ".join(words)


def _row(pair: Record) -> tuple[str, ...]:
    alignment, clicked = pair["alignment"], pair["correspondences"]
    if isinstance(clicked, dict):
        clicked = ", ".join(f"{n} {status}" for status, n in clicked.items())
    said = ""
    if alignment is not None:
        said = f"{alignment['inliers']} inliers from {alignment['start']}"
        said = "; ".join((said, *map(plain, alignment["reasons"])))
    tried = pair["state"] == "tried"
    failed = not pair["rmse_m"] or pair["verdict"] == "rejected"
    return (
        pair["other"],
        doubt_text(pair["verdict"], pair["p_grave"], pair["rivals"])
        if tried
        else pair["state"].replace("_", " "),
        "-" if failed else length_text(pair["rmse_m"]),
        "" if failed or not tried else f"{100 * pair['overlap']:.0f} %",
        f"{pair['age_s']:.0f} s ago" if tried else "",
        str(clicked or ""),
        said,
    )


def _outliers(pair: Record) -> int:
    clicked = pair["correspondences"]
    return clicked.get("outlier", 0) if isinstance(clicked, dict) else 0


def _outliers_of(record: Record, other: str) -> int:
    return next(_outliers(pair) for pair in record["pairs"] if pair["other"] == other)
