"""Row: `calibrate-check` blames no good rig, and names what is wrong with a bad one."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from fleetpose.evaluation.bench.cameras.bars import Attempt, Bar
from fleetpose.evaluation.bench.cameras.made.scene import (
    BOARD,
    FISHEYE_D,
    FISHEYE_K,
    RIG,
    SQUARE,
    seen,
    seen_through_fisheye,
)
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.stereo.matching import calibrated
from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair, open_pairs
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.checking.command import taken
from fleetpose.robot_agent.checking.report import KnownLength, check_rig

LENGTH = KnownLength(SQUARE, board=BOARD)
_P2 = (0.0, 0.001, -0.0025, 0.004, -0.005)
_PAIRS = 8


def bar(data: Path | None) -> Bar:
    """Rigs good and bad, of rendered scenes, and the good ones of a folder of recordings."""
    attempts = [*_decentred(), *_bad()]
    if data is not None:
        attempts += _recorded(data)
    return Bar("b calibrate-check", attempts, unit="not blamed, or named")


def _decentred() -> Iterator[Attempt]:
    """Right lenses off their axis, which the calibration does not know, with and without a length;
    where the length is known and the lens as good as perfect, it must say that it fits.
    """
    for p2 in _P2:
        pairs = [seen(seed, p2).pair for seed in range(2)]
        for known in (None, LENGTH):
            report = check_rig(pairs, RIG, known)
            fits = report.verdict == "fits"
            right = fits or (report.verdict == "cannot tell" and p2 != 0)
            name = f"p2 {p2:+.4f}" + (" with a length" if known else "")
            yield Attempt(name, right, f"{report.verdict}: {report.sentence}")


def _bad() -> Iterator[Attempt]:
    pairs = [seen(seed).pair for seed in range(2)]
    for name, rig, known, says in _wrong_rigs():
        report = check_rig(pairs, rig, known)
        right = report.verdict == "does not fit" and bool(re.search(says, report.sentence))
        yield Attempt(name, right, f"{report.verdict}: {report.sentence}")
    swapped = [ImagePair(pair.right, pair.left, 0) for pair in pairs]
    wide = seen_through_fisheye()
    K, D = FISHEYE_K, FISHEYE_D
    as_normal = replace(RIG, K_left=K, K_right=K, D_left=D, D_right=D)
    report = check_rig([wide.pair], as_normal, LENGTH)
    yield Attempt("a fisheye's file", "equidistant" in report.sentence, report.sentence)
    right = check_rig([wide.pair], replace(as_normal, lens="fisheye"), LENGTH)
    yield Attempt("the same, said to be one", right.verdict != "does not fit", right.sentence)
    report = check_rig(swapped, RIG)
    yield Attempt("swapped eyes", "swapped" in report.sentence, report.sentence)


def _wrong_rigs() -> Iterator[tuple[str, StereoRig, KnownLength | None, str]]:
    """Calibrations that are wrong, with a pattern of what must be said."""
    yield "baseline +5 %", _scaled(1.05), LENGTH, r"baseline is (?:4\.[5-9]|5\.[0-5]) % too long"
    yield "squares for metres", _scaled(1 / SQUARE), LENGTH, "in squares"
    yield "centimetres for metres", _scaled(10), LENGTH, "decimetres"
    for axis, deg in ((axis, deg) for axis in range(3) for deg in (2.0, -2.0)):
        T = RIG.T_right_left.copy()
        T[:3] = cv2.Rodrigues(np.radians(deg) * np.eye(3)[axis])[0] @ T[:3]
        rig = replace(RIG, T_right_left=T)
        yield f"{deg:+g} deg about {'xyz'[axis]}", rig, None, f"deg .* about {'xyz'[axis]}"
    f = RIG.K_left[0, 0]
    K = RIG.K_right * ((1.05, 1, 1), (1, 1.05, 1), (1, 1, 1))
    yield f"right focal length +5 % of {f:.0f}", replace(RIG, K_right=K), None, "focal length"


def _scaled(factor: float) -> StereoRig:
    T = RIG.T_right_left.copy()
    T[:3, 3] *= factor
    return replace(RIG, T_right_left=T)


def _recorded(data: Path) -> Iterator[Attempt]:
    """Folders of pairs with their calibration, which are all taken for good."""
    for folder in sorted(path for path in data.iterdir() if (path / "left").is_dir()):
        try:
            source = open_pairs(str(folder), "once")
            pairs = taken(source, 6 * _PAIRS, 0.0)[::_PAIRS]
            report = check_rig(pairs, calibrated(source, None))
        except FleetPoseError as error:
            yield Attempt(folder.name, False, f"refused: {error}")
            continue
        right = report.verdict != "does not fit"
        yield Attempt(folder.name, right, f"{report.verdict}: {report.sentence}")
