"""`pose-eval ablate`: what each fitted number and each stage of an alignment is worth, on one
recording: pairs are aligned with it as it is, and with a fifth less and more of it, or without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.pairs.command import limited, pairs_of, scored
from fleetpose.evaluation.bench.pairs.row import PairRow
from fleetpose.evaluation.bench.pairs.worker import (
    Answer,
    align,
    forget_views,
    widen,
)
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.metrics.scoring import Limits, percentile, share
from fleetpose.evaluation.options.recorded import AblateOptions
from fleetpose.evaluation.report.output import (
    output_folder,
    print_table,
    write_csv,
    write_summary,
)
from fleetpose.protocol.errors import FleetPoseError

Changes = Mapping[str, Any]
_TOLD = 1e-3  # smaller shares of a figure are rounding
OFF = 10**9  # more than any view has
STAGES: dict[str, Changes] = {
    "affine keypoints": {"affine": False},
    "icp": {"icp": "off"},
    "start by surfaces": {"refinement.surface_poses": 0},
    "rivals": {"rivals.least_left_over": OFF, "rivals.least_twins": OFF},
    "aliases": {"aliases.least_agreeing": OFF},
    "mirrored": {"mirrored.least_agreeing": OFF},
    "holes": {"grave_probability.most_holes": 0.0},
    "seen from which side": {"words.least_front": 0.0},
}


@dataclass(frozen=True)
class Effect:
    """Pairs of a recording with something changed.

    Attributes:
        name, value: what, and what it is now.
        right, grave: share of the pairs whose pose is right or gravely off.
        verified, grave_verified: the same of verified ones, as a share of all right pairs and as a
            count.
        position_error_m: median of the right ones.
        align_ms: median.
        failed: pairs that ended with an error.
    """

    name: str
    value: str
    right: float | None
    grave: float | None
    verified: float | None
    grave_verified: int
    position_error_m: float | None
    align_ms: float | None
    failed: int


def run(options: AblateOptions, names: Sequence[str], out: Path) -> dict[str, Any]:
    """Aligns with each change; writes ablate.csv and summary.json; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or there is no such number or stage.
    """
    changes = changes_of(names, options.by)
    recording = options.recording()
    pairs = limited(pairs_of(recording), options.limit)
    output_folder(out)
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    effects = {}
    with bench_of(options.workers) as bench:
        wires, _ = bench.on_the_wire(recording, [view for pair in pairs for view in pair])
        list(bench.pool.map(widen, wires.values()))
        files = [(wires[i.index], wires[j.index]) for i, j in pairs]
        jobs = [(label, (align_changed, change, files)) for label, change in changes.items()]
        for label, answers in bench.as_done("changes", jobs):
            rows = [
                scored(i, j, answer, limits)
                for (i, j), answer in zip(pairs, answers, strict=True)
                if answer is not None
            ]
            effects[label] = effect(label, rows, len(pairs))
    found = [effects[label] for label in changes]
    write_csv(out / "ablate.csv", Effect, found)
    summary = {"pairs": len(pairs), "effects": [vars(one) for one in found]}
    write_summary(out, summary)
    telling = [one for one in found if one is found[0] or _differs(one, found[0])]
    print_table(
        f"{len(pairs)} pairs of {options.data.name}",
        ("what", "right", "grave", "verified", "grave verified", "error m", "ms"),
        [(f"{one.name} {one.value}".strip(), *list(vars(one).values())[2:-1]) for one in telling],
    )
    if same := len(found) - len(telling):
        print(f"{same} of {len(found) - 1} changes make no difference here: see ablate.csv")
    return summary


def _differs(one: Effect, before: Effect) -> bool:
    """Whether a change shows otherwise than in the time it takes."""
    numbers = [name for name in vars(one) if name not in ("name", "value", "align_ms")]
    return any(_far(getattr(one, name), getattr(before, name)) for name in numbers)


def _far(a: float | None, b: float | None) -> bool:
    if a is None or b is None:
        return a is not b
    return abs(a - b) > _TOLD * abs(b)


def changes_of(names: Sequence[str], by: float) -> dict[tuple[str, str], Changes]:
    """What is changed, by its name and new value; nothing comes first. A number's name may be that
    of its group, or NAME=VALUE.

    Raises:
        FleetPoseError: there is no such number or stage.
    """
    known = _numbers()
    found: dict[tuple[str, str], Changes] = {("as it is", ""): {}}
    for name in names or [*STAGES, *known]:
        wanted, given, text = name.partition("=")
        chosen = [one for one in known if wanted in (one, one.partition(".")[0])]
        if wanted in STAGES and not given:
            found[wanted, "off"] = STAGES[wanted]
        elif given and wanted in known:
            found[wanted, text] = {wanted: _like(known[wanted], wanted, text)}
        elif chosen and not given:
            for one in chosen:
                for factor in (1 - by, 1 + by):
                    value = scaled(known[one], factor)
                    found[one, f"{value:.4g}"] = {one: value}
        else:
            stages, groups = ", ".join(STAGES), ", ".join(sorted({n.split(".")[0] for n in known}))
            raise FleetPoseError(
                f"'{name}' is no stage ({stages}) and no number: write GROUP.NUMBER, "
                f"GROUP.NUMBER=VALUE or a group ({groups})"
            )
    return found


def scaled(value: float, factor: float) -> float:
    """So many times a number; a whole one changes by one at least."""
    if isinstance(value, float):
        return value * factor
    step = round(value * factor) - value
    return value + (step or (1 if factor > 1 else -1))


def effect(label: tuple[str, str], rows: Sequence[PairRow], pairs: int) -> Effect:
    """What became of so many pairs with something changed: its name and value."""
    right = [row for row in rows if row.position_error_m is not None and not row.grave]
    errors = [row.position_error_m for row in right if row.position_error_m is not None]
    verified = [row for row in rows if row.verdict == "verified"]
    return Effect(
        *label,
        right=len(right) / pairs,
        grave=share(row.grave for row in rows),
        verified=sum(not row.grave for row in verified) / max(len(right), 1),
        grave_verified=sum(row.grave for row in verified),
        position_error_m=percentile(errors, 50),
        align_ms=percentile([row.align_ms for row in rows], 50),
        failed=pairs - len(rows),
    )


def align_changed(changes: Changes, pairs: Sequence[tuple[Path, Path]]) -> list[Answer | None]:
    """Runs in a worker: aligns pairs with numbers changed; none of one that ended with an error."""
    from fleetpose.pose_server.tuned import replace_in_use, tuned

    numbers = {name: value for name, value in changes.items() if "." in name}
    before = {name: tuned()[name] for name in numbers}
    forget_views()
    try:
        for name, value in numbers.items():
            replace_in_use(name, value)
        _aligned(changes, *pairs[0])  # the first one loads libraries
        return [_aligned(changes, *pair) for pair in pairs]
    finally:
        for name, value in before.items():
            replace_in_use(name, value)


def _aligned(changes: Changes, wire_i: Path, wire_j: Path) -> Answer | None:
    try:
        return align(wire_i, wire_j, changes.get("icp", "gicp"), changes.get("affine", True))
    except (FleetPoseError, ValueError, IndexError, np.linalg.LinAlgError):
        return None


def _numbers() -> dict[str, float]:
    """The fitted numbers that can be scaled, by GROUP.NUMBER."""
    import fleetpose.pose_server.workers.run  # noqa: F401  loads all that align
    from fleetpose.pose_server.tuned import tuned

    return {name: value for name, value in tuned().items() if isinstance(value, int | float)}


def _like(value: float, name: str, text: str) -> float:
    try:
        return type(value)(text)
    except ValueError as error:
        raise FleetPoseError(f"{name}={text}: write a number like {value}") from error
