"""Sends malformed input to every subscribed key of a running fleet, and looks what came of it.

Every sample sent is refused by its reader's own decoder, tried here first. So each must be counted
once, by each of its readers, and nothing else may happen.
"""

import random
import re
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.report import output
from fleetpose.evaluation.system.faults.clicker import Clicker
from fleetpose.evaluation.system.faults.desk import clickable
from fleetpose.evaluation.system.fleet import FleetPlan, observed, plan_world, start, wait_started
from fleetpose.evaluation.system.fuzz.state import Ear, Told, changes, fingerprint
from fleetpose.evaluation.system.fuzz.targets import OPERATOR, Target, targets_of
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import Link, Sample, wait_until

ROBOTS = 3
CLICKS = 8
UP_WITHIN_S = 120.0
COUNTED_WITHIN_S = 60.0
STEADY_S = 4.0
BATCH = 500  # after so many the readers are waited for: none may be replaced before it is read
LARGE_EVERY = 400  # one oversize message in so many: 16 MB each
TOKENS_EVERY = 100
_NOT_BAD = ("newer_view", "without_token", "worker_died")  # drops of good input
_TOTAL = re.compile(r" drops name=\S+ total=(\d+)")


@dataclass
class Sent:
    """What was sent, per reader: `server`, `client` and each robot's name."""

    messages: int = 0
    by_reader: Counter[str] = field(default_factory=Counter)
    by_kind: Counter[str] = field(default_factory=Counter)

    def note(self, kind: str, readers: tuple[str, ...]) -> None:
        self.messages += 1
        self.by_kind[kind] += len(readers)
        self.by_reader.update(readers)


class Counts:
    """How many drops each process tells."""

    def __init__(self, fleet: LocalFleet, observer: Observer, plan: FleetPlan) -> None:
        self._fleet, self._observer, self._plan = fleet, observer, plan
        self._before: Counter[str] = Counter()
        self._replaced_before = 0
        self._before, self._replaced_before = self.now(), self.replaced()

    def now(self) -> Counter[str]:
        """By reader, since the beginning."""
        drops = self._observer.statuses[-1][1].drops
        found = Counter(
            server=sum(n for reason, n in drops.items() if reason not in _NOT_BAD),
            client=_client_total(self._fleet.told("client")),
        )
        for name in self._plan.names:
            totals = _TOTAL.findall(_log(self._fleet, name))
            found[name] = int(totals[-1]) if totals else 0
        found.subtract(self._before)
        return found

    def replaced(self) -> int:
        """Views that were overtaken before they were read, good and bad, since the beginning."""
        drops = self._observer.statuses[-1][1].drops
        return drops.get("newer_view", 0) - self._replaced_before

    def missing(self, sent: Sent) -> int:
        """How many of those sent no reader has counted."""
        return sum((sent.by_reader - self.now()).values())


def run(messages: int, out: Path, seed: int = 0) -> dict[str, Any]:
    """Runs a fleet under fire; returns the summary.

    Raises:
        FleetPoseError: the fleet does not come up.
    """
    if messages < 1:
        raise FleetPoseError(f"--messages {messages}: give 1 or more")
    logs = output.output_folder(out) / "logs"
    for old in (*logs.glob("*.log"), *logs.glob("*.jsonl")):
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch, LocalFleet(logs) as fleet:
        summary = _fuzz(fleet, Path(scratch), messages, random.Random(seed))
        fleet.close()
        summary["leftover_processes"] = fleet.leftover_processes()
    summary["crashed"] += len(_tracebacks(logs) - set(summary["ended"]))
    output.write_summary(out, summary)
    output.print_table("refused by kind", ("kind", "sent"), sorted(summary["by_kind"].items()))
    output.print_table("fuzz", ("what", "value"), output.scalars(summary))
    for sentence in summary["changes"][:10]:
        print(sentence[:300])
    return summary


def passed(summary: dict[str, Any]) -> bool:
    """Whether nothing crashed, nothing changed, and all was counted."""
    return (
        not summary["crashed"]
        and not summary["state_changed"]
        and summary["counted"] == summary["sent"]
    )


def _fuzz(fleet: LocalFleet, scratch: Path, messages: int, chance: random.Random) -> dict[str, Any]:
    plan = plan_world([f"r{k + 1}" for k in range(ROBOTS)], scratch, moving=False, seed=0)
    keys = Keys(fleet.site)
    with ExitStack() as closing:
        start(fleet, plan, 2, scratch / "state")
        observer = closing.enter_context(observed(fleet))
        link = observer.link
        wait_started(fleet, observer, ROBOTS)
        ear = Ear(link, keys, plan.names)
        _click(fleet, plan, observer, link, keys)
        robots = (plan.names[0], plan.names[1])
        where = (fleet.endpoint, fleet.site, OPERATOR, *robots)
        fleet.start("client", "fleetpose.evaluation.system.fuzz.watching", *where, json_lines=True)
        told = _settled(fleet, observer, link, keys, scratch, ear, robots)
        targets = targets_of(keys, list(plan.names), ear.heard())
        journal = scratch / "state" / "journal.sqlite3"
        before = fingerprint(told, observer, journal)
        counts = Counts(fleet, observer, plan)
        began_s = time.monotonic()
        sent = _fire(fleet, link, keys, targets, counts, messages, chance)
        seconds = time.monotonic() - began_s
        states = observer.states_heard
        wait_until(lambda: observer.states_heard > states + 4, COUNTED_WITHIN_S)
        found = counts.now()
        overtaken = min(counts.replaced(), counts.missing(sent))
        different = changes(before, fingerprint(told, observer, journal))
        ended = fleet.exited()
        for name in ("client", *plan.names, "server"):
            fleet.stop(name)
    return {
        "messages": sent.messages,
        "sent": sum(sent.by_reader.values()),
        "counted": sum(found.values()) + overtaken,
        "replaced_unread": overtaken,
        "crashed": len(ended),
        "ended": ended,
        "state_changed": len(different),
        "changes": different,
        "seconds": round(seconds, 1),
        "by_reader": {name: [n, found[name]] for name, n in sent.by_reader.items()},
        "by_kind": dict(sent.by_kind),
    }


def _click(fleet: LocalFleet, plan: FleetPlan, observer: Observer, link: Link, keys: Keys) -> None:
    """An operator's correspondences, so that there is something to lose."""
    clicker = Clicker(link, keys, clickable(fleet, plan, observer, 2 * CLICKS), per_s=10.0)
    try:
        clicker.start()
        done = wait_running(fleet, lambda: clicker.receipted >= CLICKS, UP_WITHIN_S)
        clicker.pause()
        if not done or not clicker.settled(UP_WITHIN_S):
            raise FleetPoseError(f"no receipts; the logs are in {fleet.directory}")
    finally:
        clicker.close()


def _settled(
    fleet: LocalFleet,
    observer: Observer,
    link: Link,
    keys: Keys,
    scratch: Path,
    ear: Ear,
    robots: tuple[str, str],
) -> Told:
    """Waits until every key has been heard and nothing but time passes."""
    needed = {keys.state, keys.status}
    needed |= {k(f"r{n + 1}") for n in range(ROBOTS) for k in (keys.cloud, keys.pose, keys.camera)}
    needed |= {keys.image(robot) for robot in robots}
    journal = scratch / "state" / "journal.sqlite3"
    if not wait_running(fleet, lambda: needed <= set(ear.heard()), UP_WITHIN_S):
        missing = ", ".join(sorted(needed - set(ear.heard())))
        raise FleetPoseError(f"not heard: {missing}; the logs are in {fleet.directory}")
    (epoch,) = observer.server_epochs()
    told = Told(link, keys, epoch)
    last, since_s = fingerprint(told, observer, journal), time.monotonic()
    end_s = since_s + UP_WITHIN_S
    while time.monotonic() < since_s + STEADY_S:
        wait_running(fleet, lambda: False, 0.5)
        now = fingerprint(told, observer, journal)
        if now != last:
            last, since_s = now, time.monotonic()
        if time.monotonic() > end_s:
            raise FleetPoseError(f"the fleet does not settle; the logs are in {fleet.directory}")
    ear.stop()
    return told


def _fire(
    fleet: LocalFleet,
    link: Link,
    keys: Keys,
    targets: list[Target],
    counts: Counts,
    messages: int,
    chance: random.Random,
) -> Sent:
    """Sends in batches; within one, no cloud key comes twice."""
    sent = Sent()
    shares = [target.share for target in targets]
    with output.progress_bar() as progress:
        task = progress.add_task("messages", total=messages)
        while sent.messages < messages:
            used: set[str] = set()
            for _ in range(min(BATCH, messages - sent.messages)):
                if sent.messages % TOKENS_EVERY == TOKENS_EVERY - 1:
                    _bad_token(link, keys, sent.messages)
                    sent.note("token", ("server",))
                    continue
                (target,) = chance.choices(targets, shares)
                large = sent.messages % LARGE_EVERY == LARGE_EVERY - 2
                kind, sample = target.bad(chance, large)
                if sample.key in used:
                    continue
                if sample.key.endswith("/cloud"):
                    used.add(sample.key)
                _put(link, sample)
                sent.note(kind, target.readers)
            _wait_counted(fleet, sent, counts)
            progress.update(task, completed=sent.messages)
    return sent


def _put(link: Link, sample: Sample) -> None:
    link.session.put(
        sample.key,
        sample.payload,
        encoding=zenoh.Encoding(sample.encoding),
        attachment=sample.attachment,
        congestion_control=zenoh.CongestionControl.BLOCK,
    )


def _bad_token(link: Link, keys: Keys, number: int) -> None:
    """A token of a name or an epoch that cannot be; it comes and goes."""
    name, epoch = (("r1", f"X{number}"), (f"R.{number}", "0" * 12))[number // TOKENS_EVERY % 2]
    token = link.session.liveliness().declare_token(keys.robot_alive(name, epoch))
    wait_until(lambda: False, 0.02)
    token.undeclare()


def _wait_counted(fleet: LocalFleet, sent: Sent, counts: Counts) -> None:
    """Waits until every reader has counted what it was sent and got, or will not in time."""
    wait_until(
        lambda: bool(fleet.exited()) or counts.missing(sent) <= counts.replaced(),
        COUNTED_WITHIN_S,
        poll_s=0.1,
    )


def _client_total(lines: list[dict[str, Any]]) -> int:
    totals = [line["total"] for line in lines if line.get("type") == "drops"]
    return totals[-1] if totals else 0


def _log(fleet: LocalFleet, name: str) -> str:
    path = fleet.directory / f"{name}.log"
    return path.read_text(errors="replace") if path.exists() else ""


def _tracebacks(logs: Path) -> set[str]:
    """Names of the processes whose logs hold a traceback."""
    return {
        log.stem
        for log in logs.glob("*.log")
        if "Traceback (most recent call last)" in log.read_text(errors="replace")
    }
