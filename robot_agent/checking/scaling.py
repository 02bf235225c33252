"""What a known length says of a rig: its scale, the unit of its translation, and whether what rows
say of a yaw is to be believed.
"""

from dataclasses import replace

from fleetpose.robot_agent.checking.findings import Finding, judged
from fleetpose.robot_agent.checking.scale import Length

SCALE_TOLERANCE = 0.01  # share of a length
_LIKE = 0.03  # share by which a length may be off in another unit, and still be known in it
_UNITS = ((0.001, "millimetres"), (0.01, "centimetres"), (0.0254, "inches"), (0.1, "decimetres"))
_SQUARE_M = 0.5  # a known length of less may be the side of a square


def scale_finding(length: Length, turned: bool, baseline_m: float) -> Finding:
    """What a length says of the baseline.

    Args:
        length: as measured.
        turned: whether the rig is surely not as calibrated in other ways, which spoil lengths too.
        baseline_m: of the calibration.
    """
    state = judged(length.deviation, length.sigma, SCALE_TOLERANCE)
    says = (
        f"{length.of}: {length.measured_m:.4f} m instead of {length.known_m:g} m "
        f"({100 * length.deviation:+.1f} %, sigma {100 * length.sigma:.2f})"
    )
    if state == "off" and (unit := unit_of(length)):
        says += f": {unit}"
    elif state == "off" and turned:
        says += ": a rig that is turned makes lengths wrong as well; mend that first, check again"
    elif state == "off":
        share, long = abs(100 * length.deviation), "long" if length.deviation > 0 else "short"
        says += (
            f": the baseline is {share:.1f} % too {long}, {baseline_m:.4f} m instead of "
            f"{baseline_m / (1 + length.deviation):.4f} m; check the size of the squares or marks "
            "that the calibration was made with"
        )
    elif state == "unclear":
        says += ": take a longer length, nearer to the cameras"
    return Finding(
        "scale", 100 * length.deviation, 100 * length.sigma, 100 * SCALE_TOLERANCE, "%", state, says
    )


def unit_of(length: Length) -> str:
    """Which unit the translation is in, if the length is what it should be in that one; empty if
    in none.
    """
    if length.known_m < _SQUARE_M and abs(length.measured_m - 1) < _LIKE:
        return (
            f"it measures {length.measured_m:.4f}, as the side of a square does where the "
            "translation is in squares of the chessboard: its unit is that side, "
            f"--translation-unit {length.known_m:g} if that is what was measured"
        )
    ratio = length.measured_m / length.known_m
    for unit_m, name in _UNITS:
        if abs(ratio * unit_m - 1) < _LIKE:
            return f"the translation is in {name}: --translation-unit {unit_m:g}"
    return ""


def overruled(findings: list[Finding]) -> list[Finding]:
    """The findings, where a known length is right: disparities are then as calibrated, whatever
    rows say of a yaw, which a lens that is off its axis shows as well.
    """
    of = {finding.name: finding for finding in findings}
    scale, disparities = of.get("scale"), of.get("disparities")
    if disparities is None or scale is None or scale.state != "fits" or not disparities.ahead:
        return findings
    says = "the known length is right, and nothing is beyond infinity, whatever rows say of a yaw"
    right = replace(disparities, state="fits", sentence=says)
    return [right if one is disparities and one.state != "fits" else one for one in findings]
