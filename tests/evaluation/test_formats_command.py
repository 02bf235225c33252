"""What files say there and back, and what is not there to compare with."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.bench.formats.command import _changed_px, _evo, _kermit, _pycolmap
from fleetpose.evaluation.bench.formats.oracle import OracleError
from fleetpose.formats.reconstructions.bundler import read_bundler, write_bundler
from fleetpose.formats.reconstructions.photos import Model, Photo
from fleetpose.formats.tum import read_tum, write_tum


def model(off_px=0.0) -> Model:
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 4), (1, 1, 6), (20, 3))
    at = 500 * points[:, :2] / points[:, 2:] + off_px
    photo = Photo("a.jpg", np.full(2, 500.0), np.zeros(4), np.eye(4), np.arange(20), at)
    return Model((photo,), points, np.zeros((20, 3)))


def test_a_reprojection_that_changed_is_seen_and_one_there_and_back_is_not(tmp_path):
    write_bundler(tmp_path / "bundle.out", model())
    assert _changed_px(read_bundler(tmp_path / "bundle.out"), model()) < 1e-6
    assert _changed_px(model(0.01), model()) == pytest.approx(0.01)
    fewer = replace(model(), points=model().points[:-1])
    assert _changed_px(fewer, model()) == float("inf")
    assert _kermit(tmp_path).met
    write_bundler(tmp_path / "bundle.out", model(1.0))
    assert not _kermit(tmp_path).met


def test_without_another_python_rows_say_that_they_were_not_checked(tmp_path):
    T = np.tile(np.eye(4), (3, 1, 1))
    for name in ("r1.tum", "r1_truth.tum", "r2.tum", "r2_truth.tum"):
        write_tum(tmp_path / name, np.arange(3), T)
    (tmp_path / "scratch").mkdir()
    bars = _evo(None, tmp_path, {"r1": 0.0, "joint": 0.0}, tmp_path / "scratch")
    bars.append(_pycolmap(None, tmp_path, tmp_path))
    assert all(bar.why_not == "no --python" and not bar.met for bar in bars)
    stamps, poses = read_tum(tmp_path / "scratch" / "joint.tum")
    assert len(poses) == 6 and len(set(stamps.tolist())) == 6
    with pytest.raises(OracleError, match="pip install evo pycolmap"):
        _evo(Path("/nowhere/python"), tmp_path, {"r1": 0.0}, tmp_path / "scratch")
    with pytest.raises(OracleError, match="ended with"):
        _pycolmap(Path(sys.executable), tmp_path, tmp_path)  # ours has no pycolmap
