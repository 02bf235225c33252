"""The measure of the codecs knows what is lost, and a small run leaves its files."""

import csv
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.bench import wire
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.options.recorded import WireOptions


@pytest.fixture
def rgbd(tmp_path):
    folder = tmp_path / "rgbd"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for n in range(2):
        rows, columns = np.mgrid[0:120, 0:160]
        depth = (1500 + rows + (columns > 80) * 300 + rng.integers(0, 3, rows.shape)).astype("u2")
        depth[:10] = 0
        image = cv2.GaussianBlur(rng.integers(0, 256, (120, 160, 3), np.uint8), (0, 0), 1.5)
        cv2.imwrite(str(folder / f"frame-{n:06d}.depth.png"), depth)
        cv2.imwrite(str(folder / f"frame-{n:06d}.color.jpg"), image)
        np.savetxt(folder / f"frame-{n:06d}.pose.txt", np.eye(4))
    np.savetxt(folder / "camera-intrinsics.txt", [[150, 0, 80], [0, 150, 60], [0, 0, 1]])
    return folder


def test_a_run_writes_every_codec_and_finds_ours_lossless(rgbd, tmp_path):
    summary = wire.run(WireOptions(rgbd, views=2), tmp_path / "out")
    with (tmp_path / "out" / "wire.csv").open() as file:
        rows = {row["codec"]: row for row in csv.DictReader(file)}
    assert {"raw_float32_xyz", "raw_uint16_mm", "png16_level3", "fleetpose"} <= set(rows)
    assert tuple(next(iter(rows.values()))) == wire.COLUMNS
    assert summary["lossless"] and summary["view_bytes"] > 0
    assert float(rows["fleetpose"]["error_max_m"]) < 1e-6
    assert float(rows["raw_float32_xyz"]["bits_per_point"]) == 96
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["codecs"].keys() == set(rows)


def test_a_codec_that_loses_a_millimetre_or_a_point_is_found_out(rgbd, monkeypatch):
    recording = open_recording(rgbd)
    seen = wire.seen_of(recording, recording.usable[0])
    ours = wire.codecs_of(recording)["fleetpose"]
    assert wire.is_lossless(seen)

    def coarser(cloud):
        depth = ours.decode(cloud).copy()
        depth[50, 50] += 0.001
        return depth

    row = wire.measured(replace(ours, decode=coarser), seen)
    assert row.error_max_m == pytest.approx(0.001, rel=0.5)

    def holed(cloud):
        depth = ours.decode(cloud).copy()
        depth[50, 50] = np.nan
        return depth

    assert wire.measured(replace(ours, decode=holed), seen).error_max_m == float("inf")
    true_decoder = wire.clouds.decode_depth
    monkeypatch.setattr(wire.clouds, "decode_depth", lambda cloud: true_decoder(cloud) + 0.001)
    assert not wire.is_lossless(seen)
