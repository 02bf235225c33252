"""`--radio RATE_KBIT,DELAY_MS,LOSS`: robots behind one poor radio link; are they located, how old
are their poses, and how fast is a click?
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.radio.cell import Cell
from fleetpose.evaluation.system.radio.namespaces import why_impossible
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

CONGESTION_CONTROLS = ("reno", "bbr")
_AVAILABLE = Path("/proc/sys/net/ipv4/tcp_available_congestion_control")
_BESIDES_S = 600.0  # start, located, clicks accounted for


def run(options: FieldOptions, folder: Path, logs: Path) -> dict[str, Any]:
    """Runs a fleet with each congestion control; what each measured, under its name.

    Raises:
        FleetPoseError: a fleet does not come up.
    """
    if why := why_impossible():
        print(f"radio skipped: {why}")
        return {"skipped": why}
    summary: dict[str, Any] = {}
    for name in CONGESTION_CONTROLS:
        if name not in _AVAILABLE.read_text().split():
            print(f"radio skipped with {name}: this kernel does not have it (modprobe tcp_{name})")
            summary[f"{name}_skipped"] = "not in this kernel"
            continue
        (folder / name).mkdir()
        told = _run(Cell.of(options, name, folder / name, logs / name), logs)
        summary |= {f"{name}_{key}": value for key, value in told.items()}
    return summary


def _run(cell: Cell, logs: Path) -> dict[str, Any]:
    """Runs a fleet in a process of its own.

    Raises:
        FleetPoseError: it fails.
    """
    name = cell.congestion
    with LocalFleet(logs) as processes:
        module = "fleetpose.evaluation.system.radio.cell"
        processes.start(name, module, json.dumps(asdict(cell)), json_lines=True)
        within_s = _BESIDES_S + cell.seconds + cell.outage_s
        wait_until(lambda: bool(processes.exited()), within_s, poll_s=0.2)
        told = processes.told(name)
        if not told:
            raise FleetPoseError(f"the fleet with {name} fails:\n{processes.tail(name)}")
        return told[-1]
