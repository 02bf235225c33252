"""`pose-eval pairs` takes every view the whole way and compares with the truth."""

import csv
import json
import subprocess
import sys

import pytest

from fleetpose.evaluation.bench.pairs.command import limited, pairs_of, run
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.options.recorded import PairsOptions
from tests.data import shared_data
from tests.evaluation.makers import write_posed_views, write_rgbd


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def indices(pairs):
    return {(i.index, j.index) for i, j in pairs}


def test_every_pair_once_with_the_smaller_index_first(tmp_path):
    write_posed_views(tmp_path / "set", count=6)
    pairs = pairs_of(open_recording(tmp_path / "set", "sparse"))
    assert indices(pairs) == {(i, j) for i in range(6) for j in range(i + 1, 6)}
    assert len(pairs) == 15


def test_stereo_partners_and_views_without_clouds_are_left_out(tmp_path):
    write_posed_views(tmp_path / "set", count=4)
    assert indices(pairs_of(open_recording(tmp_path / "set", "stereo_pair_sparse"))) == {
        (0, 2), (0, 3), (1, 2), (1, 3),
    }  # fmt: skip
    (tmp_path / "set" / "stereo_pair_sparse" / "photo00.npz").unlink()
    assert indices(pairs_of(open_recording(tmp_path / "set", "stereo_pair_sparse"))) == {
        (1, 2), (1, 3),
    }  # fmt: skip


def test_a_limit_takes_pairs_from_everywhere(tmp_path):
    write_posed_views(tmp_path / "set", count=6)
    pairs = pairs_of(open_recording(tmp_path / "set", "sparse"))
    assert limited(pairs, 3) == [pairs[0], pairs[7], pairs[14]]
    assert limited(pairs, 100) == pairs
    assert limited(pairs, None) == pairs


def test_recorded_pairs_are_aligned_and_scored(tmp_path):
    church = shared_data("church_herzjesu")
    summary = run(PairsOptions(church, "sparse_noisy", limit=2), tmp_path / "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["pairs"] == 2
    assert summary["median_depth_m"] == pytest.approx(14.1, abs=0.1)
    assert summary["view_ms"] > 0
    poses, pairs = read(tmp_path / "out" / "poses.csv"), read(tmp_path / "out" / "pairs.csv")
    assert [(row["i"], row["j"]) for row in poses] == [(row["i"], row["j"]) for row in pairs]
    assert (poses[0]["i"], poses[0]["j"]) == ("0", "1")
    assert int(pairs[0]["shared"]) > 1000
    assert float(pairs[0]["position_error_m"]) < 0.05  # the first two views are side by side
    assert float(pairs[0]["rotation_error_deg"]) < 0.2
    assert (tmp_path / "out" / "precision_recall.png").exists()


def test_rgbd_pairs_have_overlap_and_no_shared_tracks(tmp_path):
    write_rgbd(tmp_path / "set", count=2)
    run(PairsOptions(tmp_path / "set", workers=1), tmp_path / "out")
    (pair,) = read(tmp_path / "out" / "pairs.csv")
    assert pair["shared"] == ""
    assert 0.8 < float(pair["overlap"]) <= 1.0  # the same wall, 10 cm aside
    assert pair["verdict"] != "verified"  # images of noise


def test_a_wrong_folder_ends_with_one_sentence_and_code_2(tmp_path):
    done = subprocess.run(
        [sys.executable, "-P", "-m", "fleetpose.evaluation", "pairs",
         "--data", str(tmp_path), "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=60,
    )  # fmt: skip
    assert done.returncode == 2
    assert "is no recording" in done.stderr
    assert "Traceback" not in done.stderr
