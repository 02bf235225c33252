"""`--rotate`: a robot is renewed, another one revoked, and the routers get their new rules one
after the other, while an operator clicks.
"""

import itertools
import time
from pathlib import Path
from typing import Any

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.field.clicking import Clicking, clicking
from fleetpose.evaluation.system.field.live import Live, live, router_process, wait_accepting
from fleetpose.protocol.transport import wait_until

RENEWED, REVOKED = "r1", "r2"
LISTENED_S = 5.0
LINKED_S = 3.0
"""A router that is back is linked to the other one again before that one is restarted."""


def run(options: FieldOptions, folder: Path, logs: Path) -> dict[str, Any]:
    """Renews, revokes, and has both routers started again.

    Raises:
        FleetPoseError: the fleet does not come up, or does not go on.
    """
    with live(folder, logs, options.robots, ("a", "b")) as it, clicking(it) as operator:
        arrived: dict[str, list[float]] = {RENEWED: [], REVOKED: []}
        with it.link("server") as link:
            for robot, times in arrived.items():
                link.subscribe_bulk(
                    it.field.keys.cloud(robot), lambda _, kept=times: kept.append(time.monotonic())
                )
            renewed_s = time.monotonic()
            it.field.keeper.renew([it.field.site.member(f"robot/{RENEWED}")])
            it.field.install(f"robot/{RENEWED}")
            _pass(LISTENED_S)
            changed_s = time.monotonic()
            it.field.keeper.revoke(it.field.site.member(f"robot/{REVOKED}"))
            for name in ("a", "b"):
                _new_rules(it, operator, name)
            both_s = time.monotonic()
            _pass(LISTENED_S)
            over_s = time.monotonic()
        told = operator.account()
    return {
        "renewed_views_gap_s": _gap(arrived[RENEWED], renewed_s, changed_s),
        "renewed_views_gap_rules_s": _gap(arrived[RENEWED], changed_s, over_s),
        "receipts_gap_s": operator.clicker.longest_gap_s(changed_s, over_s),
        "revoked_before": sum(at_s < changed_s for at_s in arrived[REVOKED]),
        "revoked_passed": sum(at_s > both_s for at_s in arrived[REVOKED]),
        **told,
        "leftover_processes": it.fleet.leftover_processes(),
    }


def _new_rules(it: Live, operator: Clicking, name: str) -> None:
    """Installs a router's new rules and starts it again, as its keeper would."""
    it.field.install(f"router/{name}")
    it.fleet.restart(router_process(name))
    wait_accepting(it, name)
    operator.wait_receipt(time.monotonic())
    _pass(LINKED_S)


def _pass(seconds: float) -> None:
    end_s = time.monotonic() + seconds
    wait_until(lambda: time.monotonic() >= end_s, seconds + 1.0)


def _gap(times: list[float], since_s: float, until_s: float) -> float:
    """The longest time without a view, which come once a second."""
    between = [at_s for at_s in times if since_s < at_s < until_s]
    return max(b - a for a, b in itertools.pairwise((since_s, *between, until_s)))
