"""`pose-eval hmi`: what the text client costs, how quick it is, how exactly one picks."""

import shutil
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.options.fleets import HmiOptions
from fleetpose.evaluation.report.output import output_folder, progress_bar, write_summary
from fleetpose.evaluation.system.terminal.meter import Metered
from fleetpose.evaluation.system.terminal.picking import Picker
from fleetpose.evaluation.system.terminal.tmux import Terminal
from fleetpose.protocol.errors import FleetPoseError

START_S = 30.0
KEY_EVERY_S = 0.4
KEY_LOST_S = 2.0
STALL_S = 4.0  # a terminal that hangs: how late is the screen afterwards
WARM_S = 5.0  # before anything counts: imports, the first paint, caches
STAND_IN = "stand-in"


@dataclass
class _Cost:
    """What was measured in the pseudo-terminal."""

    seconds: float = 0.0
    bytes_out: int = 0
    cpu_s: float = 0.0
    rss_mb: float = 0.0
    key_ms: list[float] = field(default_factory=list)
    stalled_ms: float | None = None
    lost_keys: int = 0


def run(options: HmiOptions, out: Path) -> dict[str, Any]:
    """Measures; writes summary.json.

    Raises:
        FleetPoseError: the client does not start, or ends.
    """
    folder = output_folder(out)
    shutil.rmtree(folder / "logs", ignore_errors=True)
    with LocalFleet(folder / "logs") as fleet:
        notes = fleet.directory / "updates.jsonl"
        fleet.start_router()
        moving = ["--moving"] if options.moving else []
        told = ["--robots", str(options.robots), "--notes", str(notes), *moving]
        fleet.start(STAND_IN, "fleetpose.evaluation", STAND_IN, *fleet.connection, *told)
        cost = _measured(fleet, options)
        by_keys = _picked(fleet, options, notes, by_mouse=False)
        by_mouse = _picked(fleet, options, notes, by_mouse=True)
    summary = {
        "robots": options.robots,
        "moving": options.moving,
        "mb_per_s": round(cost.bytes_out / 1e6 / cost.seconds, 4),
        "cpu_share": round(cost.cpu_s / cost.seconds, 4),
        "key_to_screen_ms_p50": percentile(cost.key_ms, 50),
        "key_to_screen_ms_p95": percentile(cost.key_ms, 95),
        "keys": len(cost.key_ms),
        "keys_lost": cost.lost_keys,
        "key_after_stall_ms": cost.stalled_ms,
        "rss_mb": round(cost.rss_mb, 1),
        "pick_error_px_max_keys": by_keys,
        "pick_error_px_max_mouse": by_mouse,
        "picks": 2 * options.targets,
    }
    write_summary(folder, summary, "the text client")
    return summary


def _client(fleet: LocalFleet, name: str) -> tuple[list[str], dict[str, str]]:
    """The command and what it needs of the environment."""
    screen = ["-m", "fleetpose.hmi_client", "screen", *fleet.connection, "--operator", name]
    return [sys.executable, "-P", *screen], {"XDG_STATE_HOME": str(fleet.directory / name)}


def _measured(fleet: LocalFleet, options: HmiOptions) -> _Cost:
    """The client under load; a key now and then, whose effect is awaited on the screen."""
    command, state = _client(fleet, "metered")
    cost = _Cost()
    with (
        Metered(command, *options.size, state) as client,
        progress_bar() as progress,
    ):
        _started(client, fleet)
        client.read_until(None, WARM_S)
        client.bytes_out, cpu_s, began_s = 0, client.cpu_s, time.monotonic()
        task = progress.add_task("seconds", total=options.seconds)
        column, step = 320, 1
        while (passed_s := time.monotonic() - began_s) < options.seconds:
            step = -1 if column >= 330 else 1 if column <= 310 else step
            column += step
            client.press(b"\x1b[C" if step > 0 else b"\x1b[D")
            took_s = client.read_until(f"{column}, ", KEY_LOST_S)
            if took_s is None:
                cost.lost_keys += 1
            else:
                cost.key_ms.append(1000 * took_s)
            client.read_until(None, KEY_EVERY_S)
            progress.update(task, completed=passed_s)
            fleet.check()
        cost.seconds = time.monotonic() - began_s
        cpu_s = client.cpu_s - cpu_s
        cost.bytes_out, cost.cpu_s, cost.rss_mb = client.bytes_out, cpu_s, client.rss_mb
        time.sleep(STALL_S)  # nobody reads: the terminal hangs
        client.press(b"\x1b[A")
        stalled_s = client.read_until(", 239 px", KEY_LOST_S)
        cost.stalled_ms = None if stalled_s is None else 1000 * stalled_s
    return cost


def _started(client: Metered, fleet: LocalFleet) -> None:
    """Waits for the fleet on the screen, and selects a pair."""
    if client.read_until("best question", START_S) is None:
        fleet.check()
        raise FleetPoseError(f"after {START_S:.0f} s the client shows no question")
    client.press(b"n")
    if client.read_until("320, 240 px", START_S) is None:
        raise FleetPoseError(f"after {START_S:.0f} s the client shows no image")


def _picked(fleet: LocalFleet, options: HmiOptions, notes: Path, by_mouse: bool) -> float:
    """The largest error of all targets, px."""
    command, state = _client(fleet, "mouse" if by_mouse else "keys")
    with Terminal(command, *options.size, state) as terminal:
        terminal.wait_text("best question", START_S)
        terminal.press("n")
        terminal.wait_text("320, 240 px", START_S)
        return Picker(terminal, notes, by_mouse).worst_px(options.targets, seed=int(by_mouse))
