"""The figures of `pose-eval pairs` in words: what summary.json calls them, and what people read."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fleetpose.evaluation.report.output import cell

PERCENT, MS, METRES, DEGREES = " %", " ms", " m", " deg"
_FORMATS = {MS: ".0f", METRES: ".3g", DEGREES: ".1f"}
_LABELS: Mapping[str, tuple[str, str]] = {  # name: words, unit
    "split": ("set of places", ""),
    "median_depth_m": ("median depth", METRES),
    "view_ms": ("a view, on robot and server (median)", MS),
    "align_ms_median": ("a pair, median", MS),
    "align_ms_settled": ("a pair that usual points settle (median)", MS),
    "align_ms_with_fallbacks": ("a pair that needs more points (median)", MS),
    "pairs": ("pairs", ""),
    "ok": ("right", PERCENT),
    "ok_below_60": ("right, below 60 deg", PERCENT),
    "ok_60_90": ("right, 60 to 90 deg", PERCENT),
    "not_grave": ("not gravely wrong", PERCENT),
    "verified": ("verified", PERCENT),
    "verified_ok": ("verified, of the right", PERCENT),
    "verified_ok_below_60": ("verified, of the right below 60 deg", PERCENT),
    "verified_of_ok_below_60": ("verified, of the right below 60 deg", PERCENT),
    "verified_of_ok_60_90": ("verified, of the right from 60 to 90 deg", PERCENT),
    "grave_verified": ("verified yet gravely wrong", ""),
    "mirrored": ("pairs of a camera that flips its images", ""),
    "mirrored_verified": ("of these verified", ""),
    "mirrored_named": ("of these named", ""),
    "wrongly_named_mirrored": ("wrongly named as flipped", ""),
    "expected_calibration_error": ("stated probability of a grave error, off by", PERCENT),
    "nees_per_dof": ("squared error by its covariance (1 is right)", ""),
    "coverage_95": ("errors within their 95 % ellipsoid", PERCENT),
    "position_error_median_m": ("position error, median", METRES),
    "share": ("share", PERCENT),
    "low": ("from", PERCENT),
    "high": ("to", PERCENT),
    "angle_deg": ("angle", DEGREES),
    "shared": ("tracks in common", ""),
    "overlap": ("overlap", PERCENT),
    "position_error_m": ("position error", METRES),
    "rotation_error_deg": ("rotation error", DEGREES),
    "grave": ("gravely wrong", ""),
    "inliers": ("inliers", ""),
    "share_of_grave": ("error, of what is grave", PERCENT),
}
_OF_A_PAIR = {"ok": "right", "i": "view", "j": "and view"}  # yes or no, not a share


def label(name: str) -> str:
    """What people read for a name of summary.json; a name that has no words of its own stays."""
    return _LABELS.get(name, (name.replace("_", " "), ""))[0]


def shown(name: str, value: Any) -> str:
    """A value with its unit: shares in per cent, yes and no in words."""
    unit = _LABELS.get(name, ("", ""))[1]
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or not isinstance(value, int | float):
        return cell(value)
    if unit == PERCENT:  # of bins `verified` is a share, of all a count
        return f"{100 * value:.1f} %" if isinstance(value, float) else str(value)
    return format(value, _FORMATS.get(unit, "")) + unit if unit else cell(value)


def listed(figures: Iterable[tuple[str, Any]]) -> list[tuple[str, str]]:
    """Names and values, each in words."""
    return [(label(name), shown(name, value)) for name, value in figures]


def tabled(
    records: Sequence[Mapping[str, Any]], names: Sequence[str] = ()
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table of records, in words.

    Args:
        records: with the same names each; without any there is no head.
        names: which of them; else all.
    """
    names = names or tuple(records[0] if records else ())
    head = tuple(
        _OF_A_PAIR.get(name, label(name)) if "i" in names else label(name) for name in names
    )
    return head, [tuple(shown(name, one[name]) for name in names) for one in records]


def named_shares(
    shares: Mapping[str, Mapping[str, Any]],
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table of shares with their intervals."""
    head, rows = tabled(list(shares.values()), ("share", "low", "high", "pairs"))
    return ("", *head), [(label(name), *row) for name, row in zip(shares, rows, strict=True)]


def binned(
    what: str, bins: Sequence[Mapping[str, Any]], in_percent: bool
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table of bins, whose first two values are their bounds."""
    bounds, scale = tuple(bins[0])[:2], 100 if in_percent else 1
    head, rows = tabled(bins, tuple(bins[0])[2:])
    unit = PERCENT if in_percent else DEGREES
    spans = ["{:g}-{:g}".format(*(scale * one[b] for b in bounds)) + unit for one in bins]
    return (what, *head), [(span, *row) for span, row in zip(spans, rows, strict=True)]
