"""`pose-eval formats`: trajectories and reconstructions of ours, beside evo and pycolmap, and there
and back.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from fleetpose.evaluation.bench.formats.fleet import sequences
from fleetpose.evaluation.bench.formats.oracle import colmap_residuals_px, evo_ate_m
from fleetpose.evaluation.bench.published.command import positions_of, write_trajectories
from fleetpose.evaluation.bench.published.play import played_of, walked
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.trajectory_error import trajectory_error
from fleetpose.evaluation.options.published import FormatsOptions
from fleetpose.evaluation.report.bars import Bar, all_met, as_rows, print_bars
from fleetpose.evaluation.report.output import output_folder, write_summary
from fleetpose.formats.reconstructions.bundler import read_bundler
from fleetpose.formats.reconstructions.colmap import read_colmap
from fleetpose.formats.reconstructions.nvm import read_nvm
from fleetpose.formats.reconstructions.photos import Model, Photo
from fleetpose.formats.tum import read_tum, write_tum
from fleetpose.pose_server.persistence.photos import reconstruction_of, write_reconstruction
from fleetpose.pose_server.persistence.placed import placed_views

SAME = 1e-6  # metres, pixels
KERMIT_PX = 0.21
_NO_PYTHON, _NO_BUNDLE = "no --python", "no --bundle"
_APART_NS = 10**15  # robots' stamps in one file: nothing is paired across robots


def run(options: FormatsOptions, out: Path) -> int:
    """Writes, reads, compares; returns 0 where all bars that were checked are met.

    Raises:
        FleetPoseError: the other Python cannot be run, or the bundle not be read.
    """
    output_folder(out)
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as name:
        scratch = Path(name)
        robots = sequences(options.robots, options.frames, scratch / "folders")
        server, refused, lost = walked(robots, scratch / "walk")
        played = played_of(server, refused, lost)
        write_trajectories(robots, played, out / "tum")
        ours = trajectory_error(positions_of(robots, played))
        bars = _evo(options.python, out / "tum", {**ours.robots_m, "joint": ours.joint_m}, scratch)
        model, images = reconstruction_of(server.site, placed_views(server.site)), {}
        for kind in ("colmap", "bundler", "nvm"):
            write_reconstruction(kind, out / kind, model, images)
        bars += [_pycolmap(options.python, out / "colmap" / "sparse" / "0", scratch)]
    bars += [
        Bar(f"{kind}, there and back: reprojection changed, px", _changed_px(again, model), SAME)
        for kind, again in (
            ("colmap", read_colmap(out / "colmap" / "sparse" / "0" / "cameras.bin")),
            ("bundler", read_bundler(out / "bundler" / "bundle.out")),
            ("nvm", read_nvm(out / "nvm" / "fleet.nvm")),
        )
    ]
    bars.append(_kermit(options.bundle))
    summary = {"bars": len(bars), "bars_met": sum(b.met for b in bars if b.checked)}
    views = {"views": len(model.photos), "points": len(model.points)}
    write_summary(out, {**summary, **views, "all_met": all_met(bars), "rows": as_rows(bars)})
    print_bars(f"formats: {len(model.photos)} views, {len(model.points)} points", bars)
    return 0 if all_met(bars) else 1


def _evo(
    python: Path | None, tum: Path, ours_m: Mapping[str, float | None], scratch: Path
) -> list[Bar]:
    """By how much evo's errors differ from ours, of each robot and of all in one file."""
    _write_joint(tum, scratch)
    bars = []
    for name, own_m in ours_m.items():
        folder = scratch if name == "joint" else tum
        what = f"evo's ATE of {name} ({own_m or 0:.6f} m): differs from ours, m"
        if python is None:
            bars.append(Bar(what, None, SAME, why_not=_NO_PYTHON))
            continue
        found_m = evo_ate_m(python, folder / f"{name}_truth.tum", folder / f"{name}.tum", scratch)
        bars.append(Bar(what, None if own_m is None else abs(found_m - own_m), SAME))
    return bars


def _write_joint(tum: Path, scratch: Path) -> None:
    """All robots' trajectories in one file, each at times of its own."""
    estimates = sorted(path for path in tum.glob("*.tum") if not path.stem.endswith("_truth"))
    for ending in ("", "_truth"):
        read = [read_tum(path.with_stem(f"{path.stem}{ending}")) for path in estimates]
        stamps_ns = [stamps + k * _APART_NS for k, (stamps, _) in enumerate(read)]
        poses = np.concatenate([poses for _, poses in read])
        write_tum(scratch / f"joint{ending}.tum", np.concatenate(stamps_ns), poses)


def _pycolmap(python: Path | None, folder: Path, scratch: Path) -> Bar:
    what = "pycolmap reads colmap: reprojection differs from ours, px"
    if python is None:
        return Bar(what, None, SAME, why_not=_NO_PYTHON)
    theirs = colmap_residuals_px(python, folder, scratch)
    ours = {photo.name: photo for photo in read_colmap(folder / "cameras.bin").photos}
    model = read_colmap(folder / "cameras.bin")
    if theirs.keys() != ours.keys():
        return Bar(what, float("inf"), SAME)
    off = [np.abs(_residuals_px(model, ours[name]) - theirs[name]).max() for name in theirs]
    return Bar(what, float(max(off)), SAME)


def _residuals_px(model: Model, photo: Photo) -> Floats:
    """(N, 2) by how much a photo's projections miss where it saw its points."""
    T = photo.T_camera_world
    K = np.diag([*photo.focal_px, 1.0])
    turn, _ = cv2.Rodrigues(T[:3, :3])
    points = model.points[photo.seen].reshape(-1, 1, 3)
    if not len(points):
        return np.zeros((0, 2))
    uv, _ = cv2.projectPoints(points, turn, T[:3, 3], K, photo.distortion)
    return uv.reshape(-1, 2) - photo.at


def _changed_px(again: Model, model: Model) -> float:
    """The most by which a residual differs from what it was; infinite where photos or points are
    others.
    """
    before = {photo.bare_name: photo for photo in model.photos}
    after = {photo.bare_name: photo for photo in again.photos}
    if before.keys() != after.keys() or len(again.points) != len(model.points):
        return float("inf")
    worst = 0.0
    for name, photo in before.items():
        rows = [
            _residuals_px(whole, one)[np.argsort(one.seen, kind="stable")]
            for whole, one in ((model, photo), (again, after[name]))
        ]
        if len(rows[0]) != len(rows[1]):
            return float("inf")
        worst = max(worst, float(np.abs(rows[0] - rows[1]).max(initial=0.0)))
    return worst


def _kermit(bundle: Path | None) -> Bar:
    what = "Bundler's own example: median reprojection, px"
    if bundle is None:
        return Bar(what, None, KERMIT_PX, why_not=_NO_BUNDLE)
    file = next(iter(sorted(bundle.rglob("bundle.out"))), bundle) if bundle.is_dir() else bundle
    model = read_bundler(file)
    off = [_residuals_px(model, photo) for photo in model.photos if photo.focal_px[0] > 0]
    return Bar(what, float(np.median(np.linalg.norm(np.concatenate(off), axis=1))), KERMIT_PX)
