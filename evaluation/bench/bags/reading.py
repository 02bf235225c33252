"""Made bags, read as a robot reads them, beside what they were made of."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.bags.scenes import Scene
from fleetpose.evaluation.bench.bags.variants import VARIANTS, Variant, write
from fleetpose.evaluation.report.bars import Bar
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.bag.recording import BagRecording
from fleetpose.robot_agent.cameras.base import DepthImage, Frame
from fleetpose.rosmsg.bag import Bag

RAW_MS = 10.0


@dataclass(frozen=True)
class Read:
    """How a bag was read.

    Attributes:
        lost: frames that did not come.
        quanta_off: the worst depth's error, in the steps in which the form counts; infinite where
            pixels have a depth that should have none, or none that should.
        error_mm: the worst depth's error.
        frame_ms: median time of a frame.
    """

    name: str
    lost: int
    quanta_off: float
    error_mm: float
    frame_ms: float


def read_variants(scene: Scene, scratch: Path) -> list[Read]:
    """Writes the scene in all forms and reads each."""
    found = []
    for k, variant in enumerate(VARIANTS):
        path = write(scratch / f"variant_{k}", scene, variant, "/r1")
        found.append(_read(path, scene, variant))
    return found


def bars_of(reads: list[Read]) -> list[Bar]:
    """Depth within its quantum, no frame lost; of raw frames the time."""
    raw = Variant().name
    bars = [Bar(f"{one.name}: depth off, quanta", one.quanta_off, 1.0) for one in reads]
    bars.append(Bar("frames lost, all forms", float(sum(one.lost for one in reads)), 0.0))
    raw_ms = next(one.frame_ms for one in reads if one.name == raw)
    return [*bars, Bar(f"{raw}: ms a frame", raw_ms, RAW_MS)]


def _read(path: Path, scene: Scene, variant: Variant) -> Read:
    bag = Bag(str(path))
    frames: list[Frame] = []
    times_ms: list[float] = []
    recording = BagRecording(bag, BagOptions())
    try:
        begin_s = time.perf_counter()
        for frame in recording.frames():
            times_ms.append(1e3 * (time.perf_counter() - begin_s))
            frames.append(frame)
            begin_s = time.perf_counter()
    finally:
        recording.close()
    by_stamp = {frame.stamp_ns: frame for frame in frames}
    quanta, errors_m = [0.0], [0.0]
    for stamp_ns, mm in zip(scene.stamps_ns, scene.depths_mm, strict=True):
        if (frame := by_stamp.get(stamp_ns)) is not None:
            q, error_m = _off(frame, mm, variant)
            quanta.append(q)
            errors_m.append(error_m)
    lost = len(set(scene.stamps_ns) - set(by_stamp))
    middle_ms = float(np.median(times_ms)) if times_ms else float("nan")
    return Read(variant.name, lost, max(quanta), 1e3 * max(errors_m), middle_ms)


def _off(frame: Frame, mm: np.ndarray, variant: Variant) -> tuple[float, float]:
    """The worst depth's error, in quanta and in metres."""
    assert isinstance(frame.ranges, DepthImage)
    found = frame.ranges.depth_m.astype(np.float64)
    there = mm > 0
    if (np.isfinite(found) != there).any():
        return float("inf"), float("inf")
    true = mm[there] / 1000.0
    off = np.abs(found[there] - true)
    return float((off / variant.quantum_m(true)).max()), float(off.max())
