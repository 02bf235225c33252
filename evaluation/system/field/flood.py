"""`--flood`: a robot sends as fast as it can, in four ways; do poses and clicks of others go on?
And a crowd of connections breaks off: how long does a new client wait?
"""

import sys
import time
from contextlib import suppress
from itertools import count, pairwise
from pathlib import Path
from typing import Any

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.field import handshakes
from fleetpose.evaluation.system.field.clicking import Clicking, clicking
from fleetpose.evaluation.system.field.live import Live, live
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until

FLOODS = ("odometry", "clouds", "tokens", "queries")
FLOODED_S = 5.0
ROBOT = "r2"
CLOUD = bytes(150_000)
OTHERS = ("r1", "r3")


def run(options: FieldOptions, folder: Path, logs: Path) -> dict[str, Any]:
    """Measures the gaps of others' poses and of receipts, quiet and under each flood.

    Raises:
        FleetPoseError: the fleet does not come up, or clicks are not receipted any more.
    """
    told: dict[str, Any] = {}
    with live(folder, logs, options.robots) as it, clicking(it) as operator:
        poses: dict[str, list[float]] = {robot: [] for robot in OTHERS}
        with it.link("observer/wall") as link:
            for robot, times in poses.items():
                key = it.field.keys.pose(robot)
                link.on_latched(key, lambda _, kept=times: kept.append(time.monotonic()))
            told |= _measured("quiet", it, operator, poses)
            it.fleet.stop(ROBOT)  # its tokens would tell its own agent that it was taken over
            for kind in FLOODS:
                _start(it, kind)
                told |= _measured(kind, it, operator, poses)
                it.fleet.stop(f"flood-{kind}")
        account = operator.account()
    told |= handshakes.run(folder / "handshakes", logs)
    return {**told, **account, "leftover_processes": it.fleet.leftover_processes()}


def _start(it: Live, kind: str) -> None:
    config = it.field.configuration(f"robot/{ROBOT}")
    name = f"flood-{kind}"
    module = "fleetpose.evaluation.system.field.flood"
    it.fleet.start(name, module, kind, it.field.site.site, str(config), json_lines=True)
    path = it.fleet.directory / f"{name}.jsonl"
    it.wait(lambda: bool(path.read_text()), "the flood does not begin")


def _measured(
    kind: str, it: Live, operator: Clicking, poses: dict[str, list[float]]
) -> dict[str, float]:
    """The longest gaps, and how long a new client takes to open."""
    began_s = time.monotonic()
    with it.link("operator/ben"):
        opened_s = time.monotonic() - began_s
    wait_until(lambda: time.monotonic() >= began_s + FLOODED_S, FLOODED_S + 2)
    over_s = time.monotonic()
    gaps_s = []
    for times in poses.values():
        kept = [began_s, *(at_s for at_s in times if began_s < at_s < over_s), over_s]
        gaps_s += [b - a for a, b in pairwise(kept)]
    return {
        f"{kind}_pose_gap_s": max(gaps_s),
        f"{kind}_receipts_gap_s": operator.clicker.longest_gap_s(began_s, over_s),
        f"{kind}_new_client_s": opened_s,
    }


def flood(kind: str, link: Link, keys: Keys) -> None:
    """Sends until ended."""
    print("1", flush=True)
    for n in count():
        match kind:
            case "odometry":
                link.session.put(keys.odometry(ROBOT), b"flood")
            case "clouds":
                link.session.put(keys.cloud(ROBOT), CLOUD)
            case "tokens":
                link.token(keys.robot_alive(ROBOT, f"{n:012x}"))
            case _:
                with suppress(UnreachableError):
                    link.query(f"{keys.relative}?from={ROBOT};to=r1", 1.0)


def main() -> None:
    """Arguments KIND SITE CONFIGURATION."""
    kind, site, config = sys.argv[1:]
    link = Link(open_session(SessionSettings(config_file=Path(config))))
    flood(kind, link, Keys(site))


if __name__ == "__main__":
    main()
