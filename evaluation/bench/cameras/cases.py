"""Row: what is wrong with a folder is either put right, or refused by a sentence that helps."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.cameras.bars import Attempt, Bar
from fleetpose.evaluation.bench.cameras.made import lost, stereo_variants, tables
from fleetpose.evaluation.bench.cameras.made.scene import median_off, seen_with
from fleetpose.evaluation.bench.cameras.made.variants import Variant
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, Frame
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig_file
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.cameras.stereo.matching import calibrated
from fleetpose.robot_agent.cameras.stereo.pairs import open_pairs
from fleetpose.robot_agent.cameras.understood import THIN_DEPTH, understood_of
from fleetpose.robot_agent.checking.command import taken
from fleetpose.robot_agent.checking.inspection import inspect
from fleetpose.robot_agent.checking.report import check_rig

MOST_OFF = 0.02
_DARKEST = 20  # mean grey level
_REMEDY = re.compile(
    r"\b(give|put|write|exchange|calibrate|bring|undistort|register|scale|swap|choose|"
    r"is it in|ask|say|set|needs?|lacks?|keep|name)\b"
)
_CALIBRATIONS = (".yaml", ".yml", ".json", ".txt", ".conf", ".xml")


def bar(scratch: Path, faults: Path | None) -> Bar:
    """Variants made here, whose truth is known, and the cases of a folder."""
    attempts = [
        tried(variant, scratch / variant.name)
        for variant in (*stereo_variants.VARIANTS, *tables.VARIANTS)
    ]
    attempts += lost.attempts(scratch / "lost")
    if faults is not None:
        attempts += [one for case in sorted(faults.iterdir()) for one in _case(case)]
    return Bar("a faulty folders", attempts, unit="right or refused")


def helps(sentence: str) -> bool:
    """Whether a refusal has a number or a name to look for, and says what to do."""
    return bool(re.search(r"\d|'|/", sentence)) and bool(_REMEDY.search(sentence))


def tried(variant: Variant, folder: Path) -> Attempt:
    """Writes a variant, opens it as a robot would, and compares its depths with the truth."""
    folder.mkdir(parents=True)
    true_m = variant.write(folder)
    try:
        camera = open_camera(variant.kind, str(folder / variant.source), "once", **variant.options)
        try:
            frames = list(camera.frames())
        finally:
            camera.close()
    except FleetPoseError as error:
        said = str(error)
        right = variant.refused is not None and bool(re.search(variant.refused, said))
        return Attempt(variant.name, right and helps(said), f"refused: {said}")
    if variant.refused is not None:
        return Attempt(variant.name, False, f"not refused: {understood_of(frames[0])}")
    off = max(_off(frame, true_m) for frame in frames)
    dark = min(float(frame.image.mean()) for frame in frames)
    right = off <= MOST_OFF and dark > _DARKEST and len(frames) == variant.frames
    return Attempt(
        variant.name, right, f"off by {100 * off:.2f} % in {len(frames)} frames, grey {dark:.0f}"
    )


def depth_of(frame: Frame) -> np.ndarray:
    """Its depths (H, W), m."""
    if isinstance(frame.ranges, DepthImage):
        return frame.ranges.depth_m
    assert isinstance(frame.ranges, DisparityImage)
    with np.errstate(divide="ignore", invalid="ignore"):
        return frame.ranges.focal_baseline_px_m / frame.ranges.disparity_px


def _off(frame: Frame, true_m: np.ndarray) -> float:
    height, width = frame.image.shape[:2]
    if true_m.shape == (480, 640):
        true_m = seen_with(np.asarray(true_m, np.float32), frame.model.K, (width, height))
    return median_off(depth_of(frame), np.asarray(true_m, np.float32))


def _case(case: Path) -> Iterator[Attempt]:
    """What is made of a case whose truth is not stated; a folder of calibrations is one for each
    file.
    """
    images = [path for path in case.rglob("*") if path.suffix in (".png", ".jpg", ".pgm")]
    if images:
        yield _folder(case)
        return
    for path in sorted(case.iterdir()):
        if path.suffix in _CALIBRATIONS:
            yield _file(case, path)


def _file(case: Path, path: Path) -> Attempt:
    name = f"{case.name}/{path.name}"
    try:
        rig = read_rig_file(path, (752, 480))
    except FleetPoseError as error:
        return Attempt(name, helps(str(error)), f"refused: {error}")
    return Attempt(name, True, f"read: {rig.size}, baseline {rig.baseline_m:.4f} m, {rig.lens}")


def _folder(case: Path) -> Attempt:
    try:
        found = inspect(str(case))
    except FleetPoseError as error:
        return Attempt(case.name, helps(str(error)), f"refused: {error}")
    says = str(found.understood)
    if found.understood.share is not None and found.understood.share < THIN_DEPTH:
        return Attempt(case.name, False, f"hardly any depth: {says}")
    if found.kind == "stereo":
        verdict = _verdict(case)
        return Attempt(case.name, verdict != "does not fit", f"{says}; calibrate-check: {verdict}")
    grey = float(next(iter(_frames(found.kind, case))).image.mean())
    return Attempt(case.name, grey > _DARKEST, f"{says}; grey {grey:.0f}")


def _frames(kind, case: Path) -> Iterator[Frame]:  # noqa: ANN001  of `CameraKind`
    camera = open_camera(kind, str(case), "once")
    yield from camera.frames()
    camera.close()


def _verdict(case: Path) -> str:
    source = open_pairs(str(case), "once")
    return check_rig(taken(source, 6, 0.0), calibrated(source, None)).verdict
