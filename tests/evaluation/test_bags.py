"""Bags held to bars: every form is read as it was written, and what is off or lost is seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.bench.bags.places import found
from fleetpose.evaluation.bench.bags.reading import bars_of, read_variants
from fleetpose.evaluation.bench.bags.scenes import Scene
from fleetpose.evaluation.bench.bags.truth import has_truth, scene_of, stripped
from fleetpose.evaluation.bench.bags.variants import VARIANTS, Variant, write
from fleetpose.evaluation.report.bars import Bar, all_met
from fleetpose.protocol.errors import DataFolderError


def made(frames=3) -> Scene:
    rng = np.random.default_rng(0)
    depths = [rng.integers(400, 5000, (48, 64), dtype=np.uint16) for _ in range(frames)]
    for depth in depths:
        depth[:4] = 0
    colours = [rng.integers(0, 256, (48, 64, 3), dtype=np.uint8) for _ in range(frames)]
    K = np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1.0]])
    stamps_ns = [1_700_000_000 * 10**9 + k * 10**8 for k in range(frames)]
    return Scene(stamps_ns, colours, depths, [np.eye(4) for _ in depths], K)


def test_every_form_is_read_as_it_was_written(tmp_path):
    reads = read_variants(made(), tmp_path)
    assert len(reads) == len(VARIANTS) and not any(one.lost for one in reads)
    assert max(one.quanta_off for one in reads) <= 1.0
    assert {one.name for one in reads if one.error_mm > 0.01} == {"mcap, jpeg, png 32FC1"}


def test_a_depth_that_is_off_and_a_frame_that_is_lost_miss_their_bars(tmp_path):
    (first, *rest) = read_variants(made(), tmp_path)
    assert all_met(bars_of([replace(first, frame_ms=9.0), *rest]))
    for spoiled in ({"quanta_off": 1.1}, {"lost": 1}, {"frame_ms": 11.0}):
        assert not all_met(bars_of([replace(first, **{"frame_ms": 9.0, **spoiled}), *rest]))


def test_a_robots_bag_holds_no_truth_and_the_evaluation_knows_its_frames(tmp_path):
    scene = made()
    source = write(tmp_path / "recorded", scene, Variant("sqlite3"), "/r7", truth=True)
    assert has_truth(source)
    again = scene_of(source)
    assert all(np.array_equal(*both) for both in zip(again.depths_mm, scene.depths_mm, strict=True))
    bag = stripped(again, tmp_path / "robot", Variant("ros1"))
    assert not has_truth(bag.path) and len(bag.poses) == len(scene.stamps_ns)
    assert found([tmp_path]) == sorted([source, bag.path])
    with pytest.raises(DataFolderError, match="no bag there"):
        found([Path(__file__).parent])


def test_what_was_not_checked_is_neither_met_nor_missed():
    open_bar = Bar("a", None, 1.0, why_not="no --python")
    assert not all_met([open_bar]) and all_met([open_bar, Bar("b", 1.0, 1.0)])
    assert not all_met([Bar("c", None, 1.0)]) and not all_met([Bar("d", float("nan"), 1.0)])
    assert open_bar.line.startswith("not checked") and "(no --python)" in open_bar.line
