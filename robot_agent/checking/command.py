"""`robot-agent calibrate-check`: takes pairs, checks the rig, says what to do."""

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fleetpose.robot_agent.cameras.stereo.matching import calibrated
from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair, PairSource, open_pairs
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.stereo.video import VideoSettings
from fleetpose.robot_agent.checking.report import KnownLength, Report, check_rig, picture_of
from fleetpose.robot_agent.checking.scale import CheckError


@dataclass(frozen=True)
class CheckOptions:
    """What `calibrate-check` is told.

    Attributes:
        data: a folder, a video, a device, or `left,right`.
        calibration: its file; None: beside the images.
        video: what is asked of a device.
        pairs: how many to take.
        interval_s: between two of a device or video.
        length_m, board, points: see `known_length`.
        save: where the picture of the first pair goes.
        as_json: print JSON instead of lines.
        translation_unit: metres that one of the calibration's translation is; None: metres.
    """

    data: str
    calibration: Path | None = None
    video: VideoSettings | None = None
    pairs: int = 10
    interval_s: float = 0.5
    length_m: float | None = None
    board: str | None = None
    points: str | None = None
    save: Path | None = None
    as_json: bool = False
    translation_unit: float | None = None


def run(options: CheckOptions) -> int:
    """Checks and prints; 0 where the calibration fits, 1 where it does not or cannot be told.

    Raises:
        FleetPoseError: there is nothing to check, or it cannot be measured.
    """
    known = known_length(options.length_m, options.board, options.points)
    source = open_pairs(options.data, "once", options.video)
    try:
        rig = calibrated(source, options.calibration, options.translation_unit)
        pairs = taken(source, options.pairs, options.interval_s)
    finally:
        source.close()
    if options.save is not None and pairs:
        _save(options.save, pairs[0], rig)
    report = check_rig(pairs, rig, known)
    if options.as_json:
        print(json.dumps(report.to_json(), indent=1))
    else:
        print("\n".join(lines_of(report, len(pairs))))
    return 0 if report.verdict == "fits" else 1


def known_length(
    length_m: float | None, board: str | None, points: str | None
) -> KnownLength | None:
    """The known length of the command line.

    Args:
        length_m: metres; None where the scale is not to be checked.
        board: inner corners of a chessboard, `9x6`, whose squares have that length.
        points: `u1,v1,u2,v2`, two pixels that far apart.

    Raises:
        CheckError: one is missing or impossible.
    """
    if length_m is None:
        if board or points:
            raise CheckError("--board and --points need --length METRES")
        return None
    if length_m <= 0 or bool(board) == bool(points):
        raise CheckError("--length needs more than 0 m, and either --board or --points")
    if board:
        corners = re.fullmatch(r"(\d+)x(\d+)", board)
        if corners is None or min(int(corners[1]), int(corners[2])) < 3:
            raise CheckError(f"--board '{board}': give inner corners along and across, e.g. 9x6")
        return KnownLength(length_m, board=(int(corners[1]), int(corners[2])))
    try:
        pixels = np.array([float(number) for number in (points or "").split(",")]).reshape(2, 2)
    except ValueError as error:
        raise CheckError(f"--points '{points}': give u1,v1,u2,v2 in pixels") from error
    if not np.isfinite(pixels).all() or (pixels[0] == pixels[1]).all():
        raise CheckError(f"--points '{points}': give two different pixels")
    return KnownLength(length_m, points=pixels)


def taken(source: PairSource, count: int, interval_s: float) -> list[ImagePair]:
    """So many pairs, or as many as the source has; a device or video is given time between."""
    pairs: list[ImagePair] = []
    for pair in _spread(source, interval_s):
        pairs.append(pair)
        if len(pairs) == count:
            break
    return pairs


def lines_of(report: Report, pairs: int) -> Iterator[str]:
    """The report for people; the verdict comes last."""
    yield f"{pairs} pairs of images"
    for finding in report.findings:
        yield f"  {finding.state:8} {finding.name:12} {finding.sentence}"
    if report.parts:
        yield "the right camera against the calibration (+- one sigma):"
    for part in report.parts:
        unit = "%" if part.name == "focal" else "deg"
        yield f"  {part.name:8} {part.value:+8.3f} +- {part.sigma:.3f} {unit}"
    yield f"calibration {report.verdict}: {report.sentence}"


def _spread(source: PairSource, interval_s: float) -> Iterator[ImagePair]:
    """A source's pairs with some time between those that come by themselves."""
    next_ns = 0
    for pair in source.pairs():
        if not source.own_pace or pair.stamp_ns >= next_ns:
            next_ns = pair.stamp_ns + round(1e9 * interval_s)
            yield pair


def _save(path: Path, pair: ImagePair, rig: StereoRig) -> None:
    if not cv2.imwrite(str(path), picture_of(pair, rig)):
        raise CheckError(f"--save {path}: cannot be written; name a .png in a folder that exists")
    print(f"picture of the rectified pair in {path}", file=sys.stderr)
