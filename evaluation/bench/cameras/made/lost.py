"""Images of two eyes of which each has lost one: what belongs together is still found."""

from itertools import product
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.cameras.bars import Attempt
from fleetpose.evaluation.bench.cameras.made.scene import save
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.stereo.pairs import PairFolder

_COUNT = 6
_FIRST_NS, _STEP_NS = 1403636579763555584, 50_000_000
_NAMES = {
    "ns": ("{ns}", "{ns}"),
    "us": ("{us}", "{us}"),
    "ms": ("{ms}", "{ms}"),
    "s": ("{s}", "{s}"),
    "stamp_after_side": ("left_{ns}", "right_{ns}"),
    "number": ("{n}", "{n}"),
    "number_after_side": ("left{n}", "right{n}"),
    "number_before_side": ("{n:06d}_L", "{n:06d}_R"),
    "frame_with_stamp": ("frame{n:06d}_{ns}", "frame{n:06d}_{ns}"),
}
_STAMPED = ("ns", "us", "ms", "s", "stamp_after_side")
_LOST = ((1, 3), (0, 5), (5, 0), (2, 2), (None, 4))
_GREY = 30  # of the first image; each later one is this much brighter


def attempts(scratch: Path) -> list[Attempt]:
    """Every way of naming with every image lost; of stamps also with the right eye 3 ms late."""
    found = []
    for (name, patterns), (left, right) in product(_NAMES.items(), _LOST):
        for late_ns in (0, 3_000_000) if name in _STAMPED else (0,):
            folder = scratch / f"{name}_{left}_{right}_{late_ns}"
            _write(folder, patterns, (left, right), late_ns)
            found.append(_tried(folder, _COUNT - len({left, right} - {None})))
    return found


def _write(
    folder: Path, patterns: tuple[str, str], lost: tuple[int | None, int | None], late_ns: int
) -> None:
    for eye, (side, pattern) in enumerate(zip(("left", "right"), patterns, strict=True)):
        for n in range(_COUNT):
            if n == lost[eye]:
                continue
            ns = _FIRST_NS + n * _STEP_NS + eye * late_ns
            name = pattern.format(
                n=n + 8, ns=ns, us=ns // 1000, ms=ns // 10**6, s=f"{ns // 10**9}.{ns % 10**9:09d}"
            )
            image = np.full((6, 8), _GREY * (n + 1), np.uint8)
            save(folder / side / f"{name}.png", image)


def _tried(folder: Path, expected: int) -> Attempt:
    try:
        pairs = list(PairFolder(folder, "once").pairs())
    except FleetPoseError as error:
        return Attempt(f"lost {folder.name}", False, f"refused: {error}")
    seen = [(int(pair.left.max()) // _GREY, int(pair.right.max()) // _GREY) for pair in pairs]
    right = all(a == b for a, b in seen) and len(seen) == expected and seen == sorted(seen)
    return Attempt(f"lost {folder.name}", right, f"pairs {seen}, expected {expected}")
