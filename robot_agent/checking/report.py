"""The whole check of a rig: from pairs of images to a verdict in words and numbers."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import LensModel
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.checking.findings import (
    Finding,
    Part,
    explained,
    parts_of,
    rig_findings,
)
from fleetpose.robot_agent.checking.fit import Fit, fit_rig, pose_of
from fleetpose.robot_agent.checking.matching import match_pairs, rectified
from fleetpose.robot_agent.checking.scale import CheckError, Length, board_length, points_length
from fleetpose.robot_agent.checking.scaling import overruled, scale_finding

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Verdict = Literal["fits", "does not fit", "cannot tell"]

_LINE_EVERY_PX = 40
_SUSPECT_PX = 0.2  # of row errors, beyond which the lenses may be of the other model
_MUCH_BETTER = 1 / 3
_TURNED = ("rows", "disparities")


@dataclass(frozen=True)
class KnownLength:
    """What the user knows: a length in metres, of a chessboard's squares (`board` inner corners)
    or between two `points` (2, 2) of the rectified left image of the first pair.
    """

    length_m: float
    board: tuple[int, int] | None = None
    points: Floats | None = None


@dataclass(frozen=True)
class Report:
    """The verdict on a rig.

    Attributes:
        verdict: `cannot tell` where nothing is surely wrong, but something is not known well
            enough.
        sentence: the verdict with its reasons and what to do.
        findings: what was measured, in the order in which it must be mended.
        parts: how the rig differs from the calibration; empty where matches are too few.
        T_right_left: (4, 4) as the matches have it, with the calibration's baseline; None likewise,
            and where it cannot be told.
        baseline_m: of the calibration.
    """

    verdict: Verdict
    sentence: str
    findings: list[Finding]
    parts: list[Part]
    T_right_left: Floats | None
    baseline_m: float

    def to_json(self) -> dict[str, Any]:
        """The same as plain numbers and words; nan becomes None."""
        content = asdict(self)
        if self.T_right_left is not None:
            content["T_right_left"] = self.T_right_left.tolist()
        for finding in content["findings"]:
            for name in ("value", "sigma"):
                if not np.isfinite(finding[name]):
                    finding[name] = None
        return content


def check_rig(pairs: list[ImagePair], rig: StereoRig, known: KnownLength | None = None) -> Report:
    """Checks a calibration against images.

    Args:
        pairs: at least one, as the cameras gave them; of different scenes where possible.
        rig: the calibration.
        known: a length to check the scale by.

    Raises:
        CheckError: there are no pairs, or the length cannot be measured.
    """
    if not pairs:
        raise CheckError("the source gave no pair of images")
    report = _checked(pairs, rig, known)
    if _row_error(report) > _SUSPECT_PX and (said := _of_another_lens(report, pairs, rig, known)):
        return replace(report, verdict="does not fit", sentence=said)
    return report


def _row_error(report: Report) -> float:
    """By how much the calibration puts matches off their rows, px; inf where that is not known."""
    of = {finding.name: finding.value for finding in report.findings}
    return max(of.get("rows", np.inf), of.get("pattern", np.inf))


def _of_another_lens(
    report: Report, pairs: list[ImagePair], rig: StereoRig, known: KnownLength | None
) -> str:
    """What to write if the numbers fit much better as those of the other model of lenses, else
    empty.
    """
    D = [np.ravel(one)[:4] for one in (rig.D_left, rig.D_right)]
    if not all(one.any() and one.size == 4 for one in D):
        return ""
    is_fisheye = rig.lens == "fisheye"
    try:
        lens: LensModel = "normal" if is_fisheye else "fisheye"
        other = _checked(pairs, replace(rig, lens=lens, D_left=D[0], D_right=D[1]), known)
    except (CheckError, CalibrationError):
        return ""
    before_px, after_px = _row_error(report), _row_error(other)
    if other.verdict == "does not fit" or not after_px < _MUCH_BETTER * before_px:
        return ""  # also where neither finds rows: both are inf
    kind, name = ("a normal lens", "radtan") if is_fisheye else ("a fisheye", "equidistant")
    return (
        f"the distortion is that of {kind}: with it matches are {after_px:.2f} px off their rows "
        f'instead of {before_px:.2f}: write "distortion_model": "{name}" into the calibration'
    )


def _checked(pairs: list[ImagePair], rig: StereoRig, known: KnownLength | None) -> Report:
    matcher = StereoMatcher(rig)
    rectifier = matcher.rectifier
    images = [rectified(rectifier, pair) for pair in pairs]
    matches = match_pairs(images)
    fit = (
        fit_rig(matches, rectifier.K, rectifier.size) if len(matches.left) > 6 else _no_fit(matches)
    )
    findings = rig_findings(matches, fit, rectifier)
    parts, T_right_left = [], None
    if len(findings) > 2:  # else there is no fit to believe
        disparity = np.median(np.abs(matches.left - matches.right)[fit.inliers, 0])
        parts = parts_of(fit, rectifier, float(disparity))
        T_right_left = _corrected(fit, matcher)
    if known is not None:
        turned = any(f.state == "off" for f in findings)
        length = _measured(known, images, matcher)
        findings.append(scale_finding(length, turned, rectifier.baseline_m))
        findings = overruled(findings)
    verdict, sentence = _verdict(findings, parts, scaled=known is not None)
    if verdict == "cannot tell":
        T_right_left = None  # nobody should correct a rig by what is not known
    return Report(verdict, sentence, findings, parts, T_right_left, rectifier.baseline_m)


def picture_of(pair: ImagePair, rig: StereoRig) -> Image:
    """Both rectified images beside each other with level lines (H, 2 W, 3): the same things must
    lie on the same line. Pixels of its left half are those of `KnownLength.points`.
    """
    both = np.hstack(rectified(StereoMatcher(rig).rectifier, pair))
    picture = np.asarray(cv2.cvtColor(both, cv2.COLOR_GRAY2BGR), np.uint8)
    picture[_LINE_EVERY_PX // 2 :: _LINE_EVERY_PX] = (0, 200, 255)
    return picture


def _no_fit(matches: Any) -> Fit:
    none = np.zeros(len(matches.left))
    return Fit(np.zeros(6), np.eye(6), none > 0, none, none, none.astype(np.intp))


def _measured(
    known: KnownLength, images: list[tuple[Image, Image]], matcher: StereoMatcher
) -> Length:
    if known.board is not None:
        return board_length(images, matcher.rectifier, known.board, known.length_m)
    if known.points is None:
        raise CheckError("--length needs what it is the length of: --board or --points")
    return points_length(matcher, images[0], known.points, known.length_m)


def _verdict(findings: list[Finding], parts: list[Part], scaled: bool) -> tuple[Verdict, str]:
    off = [f for f in findings if f.state == "off"]
    unclear = [f for f in findings if f.state == "unclear"]
    if off:
        reasons = [f.sentence for f in off if f.name not in _TURNED]
        if len(reasons) < len(off):
            turned = f"{explained(parts)}; fasten the cameras and calibrate again"
            reasons.insert(0, turned)
        return "does not fit", "; ".join(reasons)
    if unclear:
        return "cannot tell", "; ".join(f.sentence for f in unclear)
    if scaled:
        return "fits", "rows, disparities and lengths are as calibrated"
    return "fits", "rows and disparities are as calibrated; the scale is not checked: give --length"


def _corrected(fit: Fit, matcher: StereoMatcher) -> Floats:
    rectifier = matcher.rectifier
    R, t = pose_of(fit.theta)
    T = np.eye(4)
    T[:3, :3] = rectifier.R_rect_right.T @ R @ rectifier.R_rect_left
    T[:3, 3] = rectifier.R_rect_right.T @ t * rectifier.baseline_m
    return T
