"""`pose-eval bags`: robots out of bags, each bar with its figure."""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.bags.live import Watched, watch
from fleetpose.evaluation.bench.bags.places import found
from fleetpose.evaluation.bench.bags.reading import Read, bars_of, read_variants
from fleetpose.evaluation.bench.bags.scenes import Scene, walks
from fleetpose.evaluation.bench.bags.truth import has_truth, scene_of, stripped
from fleetpose.evaluation.bench.bags.variants import Variant
from fleetpose.evaluation.options.bags import BagsOptions
from fleetpose.evaluation.report.bars import Bar, all_met, as_rows, print_bars
from fleetpose.evaluation.report.output import output_folder, print_table, write_summary

LIMITS, WITH_ROS1 = (0.03, 1.0), (0.10, 2.0)  # metres, degrees
PAIRS = {
    "two robots": ((Variant(), Variant("sqlite3")), LIMITS),
    "one of ROS 1": ((Variant(), Variant("ros1")), WITH_ROS1),
}
_TOPICS_S = 120.0
_LEFT_SHARE = 0.6  # of a file that was cut off


def run(options: BagsOptions, out: Path) -> int:
    """Measures, prints, writes; returns 0 where all bars are met.

    Raises:
        FleetPoseError: bags cannot be used, or a process does not start.
    """
    bags = found(options.data)
    output_folder(out)
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as name:
        scratch = Path(name)
        made = walks(2, options.frames)
        bars, failed = topics_bar(bags)
        reads = read_variants(made[0], scratch)
        bars += [cut_off_bar(scratch / "variant_0"), *bars_of(reads)]
        seen: dict[str, Watched] = {}
        if options.live:
            scenes = recorded(bags) or made
            for what, (variants, limits) in PAIRS.items():
                seen[what] = _live(scenes, variants, scratch / what, out / "logs", options.seconds)
                bars += seen[what].bars(what, len(variants), limits)
    write_summary(out, _summary(bars, reads, seen, bags, failed))
    print_table("forms", tuple(vars(reads[0])), [tuple(vars(one).values()) for one in reads])
    print_bars("bags", bars)
    return 0 if all_met(bars) else 1


def topics_bar(bags: Sequence[Path]) -> tuple[list[Bar], list[str]]:
    """That `robot-agent topics` ends with 0 on each bag; what it said where it does not."""
    failed = []
    for bag in bags:
        done = _topics(bag)
        if done.returncode:
            failed.append(f"{bag}: {done.stderr.strip()[-300:]}")
    why_not = "" if bags else "no --data"
    name = f"robot-agent topics: ends other than by 0, of {len(bags)} bags"
    return [Bar(name, len(failed) if bags else None, 0.0, why_not=why_not)], failed


def cut_off_bar(recorder: Path) -> Bar:
    """That `robot-agent topics` reads what is left of an mcap file whose recorder was killed: ends
    with 0 and says how many messages that are.
    """
    (whole,) = recorder.glob("*.mcap")
    cut = recorder.parent / "cut_off.mcap"
    cut.write_bytes(whole.read_bytes()[: int(_LEFT_SHARE * whole.stat().st_size)])
    done = _topics(cut)
    read = done.returncode == 0 and "are left" in done.stdout
    return Bar("a cut-off mcap: its rest is read, and it is said", float(read), 1.0, at_least=True)


def _topics(bag: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "fleetpose.robot_agent", "topics", str(bag)]
    return subprocess.run(command, capture_output=True, text=True, timeout=_TOPICS_S)


def recorded(bags: Sequence[Path]) -> list[Scene]:
    """What the first two bags show that tell where they were; none of fewer."""
    truthful = [bag for bag in bags if has_truth(bag)]
    return [scene_of(bag) for bag in truthful[:2]] if len(truthful) > 1 else []


def _live(
    scenes: Sequence[Scene], variants: Sequence[Variant], folder: Path, logs: Path, seconds: float
) -> Watched:
    folder.mkdir(parents=True)
    robots = {
        f"r{k + 1}": stripped(scene, folder / f"bag_{k}", variant)
        for k, (scene, variant) in enumerate(zip(scenes, variants, strict=False))
    }
    return watch(robots, logs / folder.name.replace(" ", "_"), seconds)


def _summary(
    bars: Sequence[Bar],
    reads: Sequence[Read],
    seen: dict[str, Watched],
    bags: Sequence[Path],
    failed: Sequence[str],
) -> dict[str, object]:
    first = seen.get("two robots", Watched())
    return {
        "bars": len(bars),
        "bars_met": sum(bar.met for bar in bars if bar.checked),
        "all_met": all_met(bars),
        "bags": [str(bag) for bag in bags],
        "topics_failed": list(failed),
        "located": len(first.verified),
        "position_error_m": float(np.median(first.errors_m)) if first.errors_m else None,
        "rotation_error_deg": float(np.median(first.errors_deg)) if first.errors_deg else None,
        "clock_alarms": first.clock_alarms,
        "stale": first.stale,
        "why_not": sorted(set().union(*(one.why_not for one in seen.values()))),
        "forms": [vars(one) for one in reads],
        "rows": as_rows(bars),
    }
