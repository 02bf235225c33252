"""What is wrong with a rig, by name: measures, each with its sigma and what is tolerated.

Tolerances are the noise that the cameras' model states to whoever uses its points: half a pixel
across the rows, 0.3 px of disparity. A finding is `off` where the measure is beyond that by three
sigma, `fits` where it is within and known that well, else `unclear`.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fleetpose.robot_agent.cameras.stereo.matching import DISPARITY_SIGMA_PX, PIXEL_SIGMA_PX
from fleetpose.robot_agent.cameras.stereo.rectify import Rectifier
from fleetpose.robot_agent.checking.fit import (
    COLUMNS,
    ROWS,
    Fit,
    inverse_depths,
    jacobian,
    pose_of,
    rays_of,
    row_errors,
)
from fleetpose.robot_agent.checking.matching import Matches

Floats = npt.NDArray[np.float64]
State = Literal["fits", "off", "unclear"]

MIN_INLIERS = 100
MIN_SHARE = 0.3  # of the matches that one geometry explains
MIN_COVERAGE = 0.25  # of the image's tiles
_IN_TILE = 5  # matches that make a tile count
_SIGMAS = 3.0
DECENTRED = 0.003
"""Sigma of the tangential term p2 that a calibration may lack, or have where there is none: five of
seven good rigs moved rows as under yaws of 0.1 to 0.5 deg."""
_BEYOND = 0.01  # share of the matches that may be wrong ones
_PARTS = ("x", "y", "z", "down", "forward", "focal")


@dataclass(frozen=True)
class Finding:
    """One measure and what it means.

    Attributes:
        name: what was measured.
        value, sigma: of it, in `unit`; nan where there is none.
        tolerance: up to which it does no harm.
        state: see the module.
        sentence: what it says, and what to do where it is not `fits`.
        ahead: of disparities, whether hardly any are of points beyond infinity.
    """

    name: str
    value: float
    sigma: float
    tolerance: float
    unit: str
    state: State
    sentence: str
    ahead: bool = True


@dataclass(frozen=True)
class Part:
    """One way in which the rig can differ from its calibration.

    Attributes:
        name: `x`, `y`, `z`: rotation of the right camera about its own axes, deg, so that the true
            `R` is this rotation times the calibrated one; `down`, `forward`: direction in which
            the left camera sees the right one, deg; `focal`: right focal length over left, %.
        value, sigma: of it.
        effect_px: by how much it moves matches, about.
    """

    name: str
    value: float
    sigma: float
    effect_px: float


def judged(value: float, sigma: float, tolerance: float) -> State:
    """Whether a measure is surely beyond its tolerance, or within it and known that well."""
    if abs(value) > tolerance + _SIGMAS * sigma:
        return "off"
    return "fits" if abs(value) <= tolerance and sigma <= tolerance else "unclear"


def with_lens(sigma: float, value: float, most: float) -> float:
    """The sigma of what rows say of a yaw, with what a lens may be off its axis.

    Rows move by x y under a yaw and, two times the term p2, under a lens that is decentred; in
    disparities both differ. So a lens may explain whatever is seen, up to what lenses are.
    """
    return float(np.hypot(sigma, min(abs(value), most)))


def parts_of(fit: Fit, rectifier: Rectifier, disparity_px: float) -> list[Part]:
    """The fit's six numbers in the cameras' own axes, with sigmas.

    Args:
        fit: of the rectified rig.
        rectifier: of the calibration.
        disparity_px: a usual one, for the effects.
    """

    def own(theta: Floats) -> Floats:
        R, t = pose_of(theta)
        centre = rectifier.R_rect_left.T @ (-R.T @ t)
        was = rectifier.R_rect_left.T @ np.array((1.0, 0.0, 0.0))
        turned = rectifier.R_rect_right.T @ theta[:3]
        down, forward = (
            np.arctan2(centre[k], centre[0]) - np.arctan2(was[k], was[0]) for k in (1, 2)
        )
        return np.array((*turned, down, forward, theta[5]))

    value, J = own(fit.theta), jacobian(own, fit.theta)
    sigma = np.sqrt(np.diag(J @ fit.covariance @ J.T))
    sigma[1] = with_lens(sigma[1], value[1], 2 * DECENTRED)
    K = rectifier.K
    aside = K[0, 2] / K[0, 0] / np.sqrt(3)  # root mean square of x over the image
    effect = (1, 1, aside, disparity_px / K[0, 0], aside * disparity_px / K[0, 0], aside)
    unit = (*[180 / np.pi] * 5, 100.0)
    return [
        Part(name, float(u * v), float(u * s), float(K[0, 0] * e * abs(v)))
        for name, v, s, e, u in zip(_PARTS, value, sigma, effect, unit, strict=True)
    ]


def rig_findings(matches: Matches, fit: Fit, rectifier: Rectifier) -> list[Finding]:
    """All that matches tell, in the order in which it must be mended."""
    enough = _enough(matches, fit)
    if enough.state != "fits":
        return [enough]
    left, right = (rays_of(uv[fit.inliers], rectifier.K) for uv in (matches.left, matches.right))
    disparity = (matches.left - matches.right)[fit.inliers, 0]
    parts = parts_of(fit, rectifier, float(np.median(np.abs(disparity))))
    findings = [_swapped(fit, left, right), enough]
    if findings[0].state == "off":
        return findings
    return [
        *findings,
        _rows(fit, left, right, rectifier),
        _disparities(fit, left, right, rectifier, disparity, parts[1]),
        _left_over(fit),
        *_moments(matches, fit),
    ]


def _enough(matches: Matches, fit: Fit) -> Finding:
    inliers = int(fit.inliers.sum())
    share = inliers / max(len(fit.inliers), 1)
    counts = np.bincount(fit.tiles[fit.inliers], minlength=COLUMNS * ROWS)
    coverage = float((counts >= _IN_TILE).mean())
    state: State = "fits"
    says = (
        f"{inliers} of {len(fit.inliers)} matches agree, over {100 * coverage:.0f} % of the image"
    )
    if inliers < MIN_INLIERS or coverage < MIN_COVERAGE:
        state, says = "unclear", f"{says}: show a scene with more texture, or take more --pairs"
    elif share < MIN_SHARE:
        state, says = "unclear", f"{says}: do both images show the same moment of the same scene?"
    return Finding("matches", float(inliers), float("nan"), MIN_INLIERS, "", state, says)


def _swapped(fit: Fit, left: Floats, right: Floats) -> Finding:
    behind = float((inverse_depths(fit.theta, left, right) < 0).mean())
    state: State = "off" if behind > 0.5 else "fits"
    says = (
        "left and right are swapped: exchange the images, or calibrate in this order"
        if state == "off"
        else "left is left"
    )
    return Finding("order", 100 * behind, float("nan"), 50.0, "% behind", state, says)


def _rows(fit: Fit, left: Floats, right: Floats, rectifier: Rectifier) -> Finding:
    """The part of the row error that the calibration makes, not the noise of matches."""
    made = (fit.rows_before_px - fit.rows_after_px)[fit.inliers]
    J = jacobian(lambda theta: row_errors(theta, left, right, rectifier.K), fit.theta)
    value, sigma = _rms(made), _rms_sigma(J, fit)
    spread = 1.4826 * float(np.median(np.abs(fit.rows_after_px[fit.inliers])))
    says = (
        f"matches are {value:.2f} px off their rows (median {np.median(made):+.2f}, "
        f"noise {spread:.2f})"
    )
    state = judged(value, sigma, PIXEL_SIGMA_PX)
    return Finding("rows", value, sigma, PIXEL_SIGMA_PX, "px", state, says)


def _disparities(
    fit: Fit, left: Floats, right: Floats, rectifier: Rectifier, disparity: Floats, yaw: Part
) -> Finding:
    """What the calibration does to disparities: a yaw hardly moves rows, and spoils all depths."""
    focal = rectifier.K[0, 0]
    made = disparity - focal * inverse_depths(fit.theta, left, right)
    J = jacobian(lambda theta: focal * inverse_depths(theta, left, right), fit.theta)
    value, of_matches = _rms(made), _rms_sigma(J, fit)
    sigma = with_lens(of_matches, value, 2 * DECENTRED * focal * _rms(1 + left[:, 0] ** 2))
    share = 100 * value / max(float(np.median(np.abs(disparity - made))), 1e-6)
    says = (
        f"disparities are {value:.2f} px off ({share:.1f} % of the usual one); "
        f"{int((disparity < 0).sum())} of {len(disparity)} are negative"
    )
    state = judged(value, sigma, DISPARITY_SIGMA_PX)
    if state == "unclear" and judged(value, of_matches, DISPARITY_SIGMA_PX) == "off":
        says = says.replace("disparities are", "disparities would be")
        says += (
            f", if rows move for a yaw of {yaw.value:+.2f} deg; a lens off its axis (p2 of "
            f"{abs(np.radians(yaw.value)) / 2:.4f}) moves them alike: --length, of something far "
            "away, tells which"
        )
    elif state == "unclear":
        says += f"; the yaw is known to {yaw.sigma:.3f} deg only: take more --pairs of other scenes"
    ahead = float((disparity < -DISPARITY_SIGMA_PX).mean()) < _BEYOND
    return Finding("disparities", value, sigma, DISPARITY_SIGMA_PX, "px", state, says, ahead)


def _left_over(fit: Fit) -> Finding:
    """Rows that no rotation explains: the means of tiles, without what noise makes of them.

    Lenses that bend rows bend disparities as much, so the tolerance is theirs.
    """
    rows, tiles = fit.rows_after_px[fit.inliers], fit.tiles[fit.inliers]
    means, errors = [], []
    for tile in np.unique(tiles):
        here = rows[tiles == tile]
        if len(here) >= _IN_TILE:
            means.append(here.mean())
            errors.append(here.var(ddof=1) / len(here))
    value = float(np.sqrt(max(np.mean(np.square(means)) - np.mean(errors), 0.0)))
    sigma = float(np.sqrt(np.mean(errors) / len(errors)))
    state = judged(value, sigma, DISPARITY_SIGMA_PX)
    says = f"rows are {value:.2f} px off in a pattern that no rotation makes"
    if state != "fits":
        says += ": distortion or intrinsics do not fit these lenses; calibrate each camera again"
    return Finding("pattern", value, sigma, DISPARITY_SIGMA_PX, "px", state, says)


def _moments(matches: Matches, fit: Fit) -> list[Finding]:
    """Whether the row error changes from pair to pair, as between eyes that look at two moments."""
    of = matches.pair[fit.inliers]
    rows = [fit.rows_after_px[fit.inliers][of == k] for k in range(matches.count)]
    rows = [r for r in rows if len(r) >= MIN_INLIERS // 5]
    if len(rows) < 3:
        return []
    medians = np.array([np.median(r) for r in rows])
    value = float(medians.std(ddof=1))
    errors = [1.2533 * 1.4826 * np.median(np.abs(r)) / np.sqrt(len(r)) for r in rows]
    sigma = _rms(np.array(errors))  # of one median: what noise alone makes
    state = judged(value, sigma, PIXEL_SIGMA_PX)
    says = f"rows move by {value:.2f} px from pair to pair"
    if state == "off":
        says += ": both eyes are not taken at the same moment; synchronise them, or hold still"
    return [Finding("moments", value, sigma, PIXEL_SIGMA_PX, "px", state, says)]


def explained(parts: list[Part]) -> str:
    """What of the rig is not as calibrated, the worst first."""
    sure = [
        part
        for part in parts
        if abs(part.value) > _SIGMAS * part.sigma and part.effect_px > DISPARITY_SIGMA_PX / 2
    ]
    sure.sort(key=lambda part: -part.effect_px)
    if not sure:
        return "what has moved cannot be told from these images"
    return " and ".join(_named(part) for part in sure[:2])


def _named(part: Part) -> str:
    if part.name == "focal":
        return (
            f"the right focal length is {part.value:+.1f} % (sigma {part.sigma:.3f}) off the left"
        )
    by = f"{part.value:+.2f} deg (sigma {part.sigma:.3f})"
    if part.name in ("down", "forward"):
        return f"the right camera stands {by} further {part.name} than calibrated"
    axis = {"x": "x (pitch)", "y": "y (yaw, vergence)", "z": "z (roll)"}[part.name]
    return f"the right camera is turned by {by} about {axis} against the calibration"


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rms_sigma(J: Floats, fit: Fit) -> float:
    """Root mean square of the sigmas that the fit's uncertainty gives to values (M,)."""
    return float(np.sqrt(np.mean(np.einsum("mi,ij,mj->m", J, fit.covariance, J))))
