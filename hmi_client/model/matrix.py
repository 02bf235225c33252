"""The symmetric error matrix as texts: value, hyphen, `·` or `~`, and which values are bold."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal, get_args

from fleetpose.hmi_client.model.records import Pair, natural
from fleetpose.hmi_client.model.top_view import position_sigma_m
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import FleetState, PairCell, Verdict

HIDDEN, UNTRIED, THROUGH, SELF = "-", "·", "~", "╲"
BOLD_SHARE = 0.05
THRESHOLD_SHARE = 0.1
"""Of the scene's depth: errors above it are hidden unless the operator says otherwise. Twice what
counts as gravely off, so that noisy depths hide no right pair; and 1 m in scenes of 10 m, as it was
for all."""
THRESHOLD_M = 1.0  # while no server has told the depth
_DOUBTS = {"verified": 0.25, "plausible": 0.5, "ambiguous": 0.75, "rejected": 1.0}

Quantity = Literal["rms", "sigma", "regression", "overlap", "age", "verdict", "grave"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
_SHORT = {"verified": "sure", "plausible": "maybe", "ambiguous": "open", "rejected": "no"}
_OF_A_POSE = ("rms", "regression", "overlap")  # where a rejected one has none


@dataclass(frozen=True)
class Cell:
    """One cell's text; `verdict` of a shown value, `clicked` if the pair has correspondences,
    `level` the value's share of the largest shown one.
    """

    text: str
    bold: bool = False
    verdict: Verdict | None = None
    clicked: bool = False
    level: float | None = None


@dataclass(frozen=True)
class Matrix:
    """Texts of all cells; ask by two robots in either order."""

    robots: tuple[str, ...]
    unit: Literal["cm", "m"]
    cells: dict[Pair, Cell]
    width: int = 1
    """Length of the longest text."""
    components: dict[str, str] = field(default_factory=dict)
    """Of each robot that has a pose."""

    def at(self, a: str, b: str) -> Cell:
        if a == b:
            return Cell(SELF)
        known = self.cells.get(ordered_pair(a, b))
        if known is not None:
            return known
        return Cell(THROUGH if are_joined(self.components, a, b) else UNTRIED)


def is_shown(cell: PairCell, threshold_m: float) -> bool:
    """Whether a cell shows its error: aligned, not rejected, not above the threshold."""
    tried = cell.state == "tried" and cell.rmse_m is not None and cell.verdict != "rejected"
    return tried and cell.rmse_m is not None and cell.rmse_m <= threshold_m


def default_threshold_m(depth_m: float | None) -> float:
    """Above which error a cell is a hyphen where no operator has said so; metres."""
    return THRESHOLD_M if depth_m is None else THRESHOLD_SHARE * depth_m


def matrix_of(fleet: FleetState, threshold_m: float, quantity: Quantity = "rms") -> Matrix:
    """The matrix of a fleet: what the last alignment of each pair gave. Of errors, the largest 5 %
    of the shown ones, at least one, are bold, and those above the threshold a hyphen. So is what a
    pair does not have whose last alignment was rejected.
    """
    robots = tuple(sorted((r.robot for r in fleet.robots), key=natural))
    errors = {(c.i, c.j): c.rmse_m or 0.0 for c in fleet.pairs if is_shown(c, threshold_m)}
    unit: Literal["cm", "m"] = "cm" if max(errors.values(), default=0.0) < 1.0 else "m"
    ranked = sorted(errors, key=lambda pair: -errors[pair])
    bold = set(ranked[: max(1, int(BOLD_SHARE * len(ranked)))])
    if quantity == "sigma":
        return _sigmas(fleet, robots)
    cells = {}
    highest = max((_value(c, quantity) for c in fleet.pairs if (c.i, c.j) in errors), default=0.0)
    for cell in fleet.pairs:
        pair = (cell.i, cell.j)
        clicked = cell.correspondences > 0
        if cell.state != "tried":
            states = {"untried": UNTRIED, "through_others": THROUGH}
            cells[pair] = Cell(states[cell.state], clicked=clicked)
        elif _is_hidden(cell, quantity, pair in errors):
            cells[pair] = Cell(HIDDEN, clicked=clicked)
        else:
            error = quantity in ("rms", "regression")
            text = _text(cell, quantity, unit)
            level = min(_value(cell, quantity) / highest, 1.0) if highest else 0.0
            cells[pair] = Cell(text, error and pair in bold, cell.verdict, clicked, level)
    width = max((len(cell.text) for cell in cells.values()), default=1)
    return Matrix(robots, unit, cells, width, components_of(fleet))


def _sigmas(fleet: FleetState, robots: tuple[str, ...]) -> Matrix:
    """How unsure the pose of one robot in the other's is, cm, whether or not their pair was tried:
    at most, as if their poses were known independently.
    """
    poses = {r.robot: r.pose for r in fleet.robots if r.pose is not None}
    clicked = {(c.i, c.j) for c in fleet.pairs if c.correspondences > 0}
    square = {robot: position_sigma_m(pose) ** 2 for robot, pose in poses.items()}
    components = components_of(fleet)
    known = {
        ordered_pair(a, b): math.sqrt(square[a] + square[b])
        for a, b in combinations(robots, 2)
        if are_joined(components, a, b)
    }
    largest = max(known.values(), default=0.0) or 1.0
    cells = {
        pair: Cell(f"{100 * sigma:.1f}", clicked=pair in clicked, level=sigma / largest)
        for pair, sigma in known.items()
    }
    cells |= {pair: Cell(UNTRIED, clicked=True) for pair in clicked - set(cells)}
    width = max((len(cell.text) for cell in cells.values()), default=1)
    return Matrix(robots, "cm", cells, width, {})


def _is_hidden(cell: PairCell, quantity: Quantity, error_shown: bool) -> bool:
    if quantity == "grave":
        return cell.p_grave is None
    failed = cell.verdict == "rejected" and quantity in _OF_A_POSE
    return failed or (quantity in ("rms", "regression") and not error_shown)


def title_of(quantity: Quantity, unit: str) -> str:
    """What a matrix shows, with its unit."""
    return {
        "rms": f"point residual (rms), {unit}",
        "sigma": "pose sigma (at most), cm",
        "regression": "regression errors, m2",
        "overlap": "overlap, %",
        "age": "age, s",
        "verdict": "verdicts",
        "grave": "chance of a grave error, %",
    }[quantity]


def _value(cell: PairCell, quantity: Quantity) -> float:
    """What is shown, as a number from 0 up."""
    match quantity:
        case "rms" | "sigma":
            return cell.rmse_m or 0.0
        case "regression":
            return cell.regression_error_m2 or 0.0
        case "overlap":
            return cell.overlap
        case "age":
            return cell.age_s
        case "verdict":
            return _DOUBTS.get(cell.verdict or "rejected", 1.0)
        case "grave":
            return cell.p_grave or 0.0


def _text(cell: PairCell, quantity: Quantity, unit: str) -> str:
    match quantity:
        case "rms" | "sigma":
            rmse_m = cell.rmse_m or 0.0
            return f"{100 * rmse_m:.1f}" if unit == "cm" else f"{rmse_m:.2f}"
        case "regression":
            return f"{cell.regression_error_m2 or 0.0:.2g}"
        case "overlap":
            return f"{100 * cell.overlap:.0f}"
        case "age":
            return f"{cell.age_s:.0f}"
        case "verdict":
            return f"{1 + cell.rivals} fit" if cell.rivals else _SHORT[cell.verdict or "rejected"]
        case "grave":
            return percent_text(cell.p_grave or 0.0).removesuffix(" %")


def doubt_text(verdict: str | None, p_grave: float | None, rivals: int) -> str:
    """A verdict and what speaks against it, in words: `ambiguous: 3 poses fit, 40 % likely to be
    gravely off`. Of what was rejected nobody asks that.
    """
    doubts = [f"{1 + rivals} poses fit"] if rivals and verdict != "rejected" else []
    if p_grave is not None and verdict != "rejected":
        doubts.append(f"{percent_text(p_grave)} likely to be gravely off")
    separator = ": " if rivals else ", "
    return separator.join((verdict or "tried", *((", ".join(doubts),) if doubts else ())))


def percent_text(share: float) -> str:
    """A probability for reading: 12 %, 0.4 %, <0.1 %, and 100 % only where it is sure."""
    percent = 100 * share
    if percent < 0.1:
        return "0 %" if share <= 0 else "<0.1 %"
    if 99.5 <= percent < 100:
        return ">99 %"
    return f"{percent:.0f} %" if percent >= 9.95 else f"{percent:.1f} %"


def components_of(fleet: FleetState) -> dict[str, str]:
    """The component of each robot that has a pose."""
    return {r.robot: r.pose.component for r in fleet.robots if r.pose is not None}


def are_joined(components: Mapping[str, str], a: str, b: str) -> bool:
    """Whether two robots are known through others, if not by an alignment of their own."""
    return a in components and components[a] == components.get(b)


def length_text(metres: float) -> str:
    """A length with its unit: 8 mm, 3.2 cm, 1.50 m."""
    if metres < 0.01:
        return f"{1000 * metres:.1f} mm"
    return f"{100 * metres:.1f} cm" if metres < 1 else f"{metres:.2f} m"
