"""`--routers 2 --kills N`: routers are killed one after the other while an operator clicks, and
each is frozen once.
"""

import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.field.clicking import Clicking, clicking
from fleetpose.evaluation.system.field.live import Live, live, router_process, wait_accepting
from fleetpose.protocol.transport import wait_until

_PAUSE_S = (1.0, 2.5)  # between a router that is back and the next kill: both are linked again
DOWN_S = 0.5
_FROZEN_S = (6.0, 8.0)


def run(options: FieldOptions, folder: Path, logs: Path) -> dict[str, Any]:
    """Kills routers as often as is asked for, and freezes each of two; what the operator waited for
    and lost.

    Raises:
        FleetPoseError: the fleet does not come up, or clicks are not receipted any more.
    """
    names, chance = ("a", "b")[: options.routers], random.Random(options.seed)
    with live(folder, logs, options.robots, names) as it, clicking(it) as operator:
        gaps_s, hit_s = [], []
        for _ in range(options.kills):
            time.sleep(chance.uniform(*_PAUSE_S))
            before = operator.routers()
            gaps_s.append(_kill(operator, chance.choice(names)))
            if operator.routers() != before:
                hit_s.append(gaps_s[-1])
        frozen_s = []
        for name in names if options.routers > 1 else ():
            time.sleep(_PAUSE_S[1])
            frozen_s.append(_freeze(operator, name, chance.uniform(*_FROZEN_S)))
        told = operator.account()
        opened_s = _opened_first_dead_s(it) if options.routers > 1 else None
    return {
        "routers": options.routers,
        "kills": options.kills,
        "kills_of_operators_router": len(hit_s),
        "receipts_gap_s_p95": float(np.percentile(gaps_s, 95)),
        "receipts_gap_of_hit_s_p95": float(np.percentile(hit_s, 95)) if hit_s else None,
        "receipts_gap_s_max": max(gaps_s),
        "frozen": len(frozen_s),
        "frozen_receipts_gap_s_max": max(frozen_s, default=None),
        **told,
        "opened_first_dead_s": opened_s,
        "leftover_processes": it.fleet.leftover_processes(),
    }


def _kill(operator: Clicking, name: str) -> float:
    """Kills a router, starts it again as its supervisor would; the longest time without receipt."""
    fleet, killed_s = operator.it.fleet, time.monotonic()
    fleet.kill(router_process(name))
    wait_until(lambda: time.monotonic() > killed_s + DOWN_S, 2 * DOWN_S)
    fleet.restart(router_process(name))
    wait_accepting(operator.it, name)
    operator.wait_receipt(time.monotonic())
    return operator.clicker.longest_gap_s(killed_s, time.monotonic())


def _freeze(operator: Clicking, name: str, seconds: float) -> float:
    """Stops a router as a machine that hangs would, with its links open; the longest time without
    receipt until it has gone on for a while.
    """
    pid, frozen_s = operator.it.fleet.pid(router_process(name)), time.monotonic()
    os.kill(pid, signal.SIGSTOP)
    try:
        wait_until(lambda: time.monotonic() > frozen_s + seconds, 2 * seconds)
    finally:
        os.kill(pid, signal.SIGCONT)
    operator.wait_receipt(time.monotonic())
    return operator.clicker.longest_gap_s(frozen_s, time.monotonic())


def _opened_first_dead_s(it: Live) -> float:
    """How long a session takes to open while the first router of its list is dead."""
    process = router_process("a")
    it.fleet.kill(process)
    began_s = time.monotonic()
    with it.link("observer/wall"):
        took_s = time.monotonic() - began_s
    it.fleet.restart(process)
    return took_s
