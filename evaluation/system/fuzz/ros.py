"""`pose-eval fuzz --ros`: damaged messages, tokens, attachments and bags of ROS, each given to what
reads it. It may refuse them by an error of ours, which is counted, or take what is left.
"""

import logging
import random
import signal
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from fleetpose.evaluation.report import output
from fleetpose.evaluation.system.fuzz.ros_pieces import (
    Pieces,
    at_the_start,
    in_bags,
    in_messages,
    in_tokens,
)
from fleetpose.evaluation.system.fuzz.ros_wire import Wire
from fleetpose.protocol.errors import FleetPoseError

HUNG_S = 1.0  # of the processor's time
GIVEN_UP_S = 20.0
SHARES = {"messages": 0.5, "start": 0.15, "tokens": 0.2, "wire": 0.14, "bags": 0.01}
_TOLD = 10


class _Hangs(BaseException):
    """It did not come back; nothing that reads foreign bytes may catch this."""


@dataclass
class Outcome:
    """What became of damaged input, by kind.

    Attributes:
        given: to its reader.
        refused: by an error of ours.
        taken: what was left could be used.
        escaped: what came out as another error: where, how often.
        traces: of the first of each.
        slow: kinds and seconds of what took too long.
    """

    given: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    taken: Counter[str] = field(default_factory=Counter)
    escaped: Counter[str] = field(default_factory=Counter)
    traces: dict[str, str] = field(default_factory=dict)
    slow: list[tuple[str, float]] = field(default_factory=list)

    def give(self, kind: str, use: Callable[[], object]) -> None:
        """Gives one piece to its reader."""
        self.given[kind] += 1
        begin_s = time.thread_time()
        try:
            with _at_most(GIVEN_UP_S):
                use()
            self.taken[kind] += 1
        except FleetPoseError:
            self.refused[kind] += 1
        except (Exception, _Hangs) as error:  # whatever it is, it should not have come out
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{kind}: {type(error).__name__} at {Path(last.filename).name}:{last.lineno}"
            self.escaped[where] += 1
            self.traces.setdefault(where, "".join(traceback.format_exception(error)[-8:]))
        if (seconds := time.thread_time() - begin_s) > HUNG_S:
            self.slow.append((kind, round(seconds, 2)))


def run(count: int, out: Path, seed: int = 0) -> dict[str, Any]:
    """Tries so many damaged pieces; returns the summary.

    Raises:
        FleetPoseError: too few are asked for.
    """
    if count < len(SHARES):
        raise FleetPoseError(f"--count {count}: give {len(SHARES)} or more")
    output.output_folder(out)
    chance, outcome = random.Random(seed), Outcome()
    shares = {kind: max(int(share * count), 1) for kind, share in SHARES.items()}
    shares["messages"] += count - sum(shares.values())
    with ExitStack() as closing:
        closing.enter_context(_quiet())
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="fleetpose-")))
        wire = closing.enter_context(Wire.opened())
        pieces: dict[str, Pieces] = {
            "messages": in_messages(chance),
            "start": at_the_start(chance),
            "tokens": in_tokens(chance),
            "wire": wire.pieces(chance),
            "bags": in_bags(chance, folder),
        }
        progress = closing.enter_context(output.progress_bar())
        for kind, one_after_the_other in pieces.items():
            few = islice(one_after_the_other, shares[kind])
            for what, use in progress.track(few, shares[kind], description=kind):
                outcome.give(f"{kind}: {what}", use)
        frames_after = wire.frames()
    return _told(outcome, frames_after, out)


def passed(summary: dict[str, Any]) -> bool:
    """Whether all was refused or taken, nothing hung, and the robot still gives frames."""
    counted = summary["refused"] + summary["taken"] == summary["given"]
    return counted and not summary["hung"] and summary["frames_after"] > 0


def _told(outcome: Outcome, frames_after: int, out: Path) -> dict[str, Any]:
    summary = {
        "given": outcome.given.total(),
        "refused": outcome.refused.total(),
        "taken": outcome.taken.total(),
        "escaped": outcome.escaped.total(),
        "hung": len(outcome.slow),
        "frames_after": frames_after,
        "escapes": dict(outcome.escaped),
        "slow": outcome.slow,
        "by_kind": {
            kind: [n, outcome.refused[kind], outcome.taken[kind]]
            for kind, n in sorted(outcome.given.items())
        },
    }
    output.write_summary(out, summary)
    rows = [(kind, *counts) for kind, counts in summary["by_kind"].items()]
    output.print_table("damaged", ("kind", "given", "refused", "taken"), rows)
    output.print_table("fuzz --ros", ("what", "value"), output.scalars(summary))
    for where, trace in list(outcome.traces.items())[:_TOLD]:
        print(f"{outcome.escaped[where]} x {where}\n{trace}")
    return summary


@contextmanager
def _quiet() -> Iterator[None]:
    """What readers warn of is counted here."""
    logger = logging.getLogger("fleetpose")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    def give_up(*_: object) -> None:
        raise _Hangs(f"not back after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
