"""`--attacks`: what passes of what nobody may do, and whether the routers name who tried."""

import secrets
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import zenoh

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.report.output import write_csv
from fleetpose.evaluation.system.field.attackers.attempts import Attempt, Victims, attempts, play
from fleetpose.evaluation.system.field.attackers.denials import HeardDenials, names
from fleetpose.evaluation.system.field.attackers.strangers import EVIL, Stranger, entered, strangers
from fleetpose.evaluation.system.field.live import Live, live
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

TOLD_WITHIN_S = 10.0
SCREEN = ("r1", "r3")
_SLOWER = 1.25


def run(options: FieldOptions, folder: Path, logs: Path) -> dict[str, Any]:
    """Runs a fleet, lets it be for a while, then attacks it.

    Raises:
        FleetPoseError: it does not come up, or what may pass does not.
    """
    with live(folder, logs, options.robots) as it, it.link("server") as link:
        heard = HeardDenials(link, it.field.keys)
        false_alarms = quiet(it, heard, options.quiet_s)
        tried = attack(it, heard)
        came = come_in(it, heard)
        it.fleet.check()
    named = [one["named"] for one in tried]
    write_csv(logs.parent.parent / "attacks.csv", list(tried[0]), tried)
    for one in (one for one in (*tried, *came) if one["passed"] or not one["named"]):
        print(f"{one['who']} {one['verb']} {one['key']}: passed {one['passed']}, "
              f"named {one['named']}")  # fmt: skip
    for alarm in false_alarms:
        print(f"false alarm: {alarm}")
    return {
        "tried": len(tried) + len(came),
        "passed": sum(one["passed"] for one in (*tried, *came)),
        "named_share": sum(named) / len(named),
        "strangers": len(came),
        "strangers_named": sum(one["named"] for one in came),
        "quiet_s": options.quiet_s,
        "false_alarms": len(false_alarms),
    }


def quiet(it: Live, heard: HeardDenials, seconds: float) -> list[str]:
    """What is denied while a screen follows two robots and another client joins late: nothing
    should be. It counts from the router's start on.
    """
    end_s = time.monotonic() + seconds
    with ExitStack() as closing:
        screen = closing.enter_context(it.client("operator/anna"))
        closing.enter_context(it.client("observer/wall"))
        it.wait(lambda: set(SCREEN) <= set(screen.robots()), "the screen hears of no robots", 20)
        screen.select(*SCREEN)
        _wait_running(it, end_s - seconds / 2)
        late = closing.enter_context(it.client("operator/ben"))
        it.wait(lambda: late.fleet is not None, "who joins late hears nothing", 20)
        _wait_running(it, end_s)
    return [f"{who} {what} {key} {n}" for (who, what, key), n in heard.denied().items()] + [
        f"refused: {cause} {n}" for cause, n in heard.refused().items()
    ]


def _wait_running(it: Live, until_s: float) -> None:
    left_s = until_s - time.monotonic()
    if left_s > 0:
        it.wait(lambda: time.monotonic() >= until_s, "time stands still", left_s + 5)


def attack(it: Live, heard: HeardDenials) -> list[dict[str, Any]]:
    """Makes every attempt beside the fleet; what each reached, and whether it was named.

    They are made no faster than routers let the slowest stream through: what they thin out neither
    passes nor comes to the rules, so it proves nothing.
    """
    tried, pause_s = attempts(it.field.keys), _SLOWER / it.field.site.rates.views_hz
    with ExitStack() as closing:

        def open_(who: str) -> zenoh.Session:
            return closing.enter_context(it.field.open(who))

        victims = Victims(it.field, open_)
        sessions = {who: open_(who) for who in {one.who for one in tried}}
        before = heard.denied()
        kept = []
        for number, one in enumerate(tried):
            kept.append(play(sessions[one.who], number, one))
            time.sleep(pause_s)
        for number, one in enumerate(tried):
            if one.verb == "answer":
                one.reached += victims.ask(number, one)
        _wait_passed(it, victims, sessions["robot/r2"])
        for number, one in enumerate(tried):
            one.reached += victims.reached(number, one)

        def unnamed() -> list[Attempt]:
            grown = heard.denied() - before
            return [one for one in tried if not names(grown, one.who, one.verb, one.kind)]

        wait_until(lambda: not unnamed(), TOLD_WITHIN_S, poll_s=0.2)
        left = unnamed()
        for declared in kept:
            if declared is not None:
                declared.undeclare()
    return [_row(one, one not in left) for one in tried]


def _row(one: Attempt, named: bool) -> dict[str, Any]:
    told = {"who": one.who, "verb": one.verb, "key": one.kind}
    return {**told, "passed": int(bool(one.reached)), "named": int(named)}


def _wait_passed(it: Live, victims: Victims, r2: zenoh.Session) -> None:
    """Puts what may pass until it is heard: all that was put before has passed by then, or not."""
    mark, keys = secrets.token_bytes(8), it.field.keys

    def passed() -> bool:
        r2.put(keys.image("r2"), mark)
        return mark in victims.marks()

    if not wait_until(passed, TOLD_WITHIN_S, poll_s=0.3):
        raise FleetPoseError("what r2 may say does not pass either; nothing can be concluded")


def come_in(it: Live, heard: HeardDenials) -> list[dict[str, Any]]:
    """Strangers try to come in; those whom TLS lets in say what robots say."""
    with ExitStack() as closing:
        victims = Victims(it.field, lambda who: closing.enter_context(it.field.open(who)))
        return [_comes(it, heard, victims, one) for one in strangers(it.field)]


def _comes(it: Live, heard: HeardDenials, victims: Victims, one: Stranger) -> dict[str, Any]:
    before, mark = heard.refused(), secrets.token_bytes(4)
    inside = entered(it.field, one, mark)
    named = wait_until(lambda: bool((heard.refused() - before)[one.cause]), TOLD_WITHIN_S)
    passed = inside or EVIL + mark in victims.marks()
    told = {"who": one.name, "verb": "comes in", "key": one.cause}
    return {**told, "passed": int(passed), "named": int(named)}
