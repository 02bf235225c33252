"""What to say about a point, from what was measured of it."""

from typing import Any

GOOD_PX = 4.0  # a hand is off by a pixel or two, twice
LOOKS_THE_SAME = 0.6  # correlation of two places that an eye takes for one
_JUMP = 3.0  # times as far as the pixels tell: another surface


def is_bad(point: dict[str, Any]) -> bool:
    """Whether a point is off by more than a hand, or on something that the other image lacks."""
    if point["why"] in ("outside", "hidden"):
        return True
    return point["off_px"] is not None and (point["off_px"] > GOOD_PX or _on_another_surface(point))


def advice(point: dict[str, Any]) -> str:
    """One sentence about a point; empty where it is good.

    Args:
        point: of the report.
    """
    if point["why"] == "no pose":
        return "Nothing to hold it against: poses of these two views are not known."
    if point["why"] == "no depth":
        return f"{point['i']}'s pixel shows nothing of known depth: pick a wall, not the sky."
    if not is_bad(point):
        return ""
    if point["steps"]:
        count = abs(point["steps"])
        further = "one step" if count == 1 else f"{count} steps"
        return (
            f"{metres(point['off_m'])} off: the same pattern {further} further; pick a corner "
            "beside something unique."
        )
    if point["why"] == "outside":
        return f"{point['j']}'s image does not show that place at all; pick one that both show."
    if point["why"] == "hidden":
        return f"In {point['j']}'s image something stands before that place; pick another one."
    off = f"{point['off_px']:.0f} px off"
    if (point["alike"] or 0.0) >= LOOKS_THE_SAME:
        return (
            f"{off}: the right place looks nearly the same ({point['alike']:.2f} of 1); pick a "
            "corner beside something unique."
        )
    if _on_another_surface(point):
        return (
            f"{off}, but {metres(point['off_m'])} in depth: it is beside an edge; pick a corner "
            "on the surface itself."
        )
    if point["off_px"] > 10 * GOOD_PX:
        return f"{off}, and the two places do not look alike: compare both loupes before you pick."
    return f"{off}: let s snap to the corner, or move the cursor pixel by pixel in the loupe."


def _on_another_surface(point: dict[str, Any]) -> bool:
    """Near in the image and far in the world."""
    off_m, scale = point["off_m"], point["px_m"]
    return (
        None not in (off_m, scale)
        and point["off_px"] <= 10 * GOOD_PX
        and off_m > _JUMP * max(point["off_px"], GOOD_PX) * scale
    )


def metres(value: float | None) -> str:
    """A length as one reads it: centimetres below a metre."""
    if value is None:
        return "-"
    return f"{100 * value:.1f} cm" if value < 1 else f"{value:.1f} m"
