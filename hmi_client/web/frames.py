"""Binary frames for a page: an 8-byte header `<BBHI` (kind, side, n, id), then arrays as they are.

All numbers are little endian. A page reads them without copying.
"""

import struct
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.model.matrix import (
    QUANTITIES,
    Quantity,
    components_of,
    is_shown,
)
from fleetpose.hmi_client.model.records import Pair, Picture
from fleetpose.hmi_client.model.top_view import (
    heading_rad,
    position,
    position_covariance,
    position_sigma_m,
)
from fleetpose.protocol.messages import FleetState, PairCell, RobotPose

Floats = npt.NDArray[np.floating]

IMAGE, MATRIX, POSES, CLOUD = 1, 2, 3, 4
HEADER = struct.Struct("<BBHI")
_STATES = {"untried": 0, "through_others": 1, "tried": 2}
_KNOWN = 1
_VERDICTS = {None: 0, "verified": 1, "plausible": 2, "ambiguous": 3, "rejected": 4}
_CLICKED, _ASKED, _HIDDEN = 1 << 5, 1 << 6, 1 << 7
_FINEST_M, _STEPS = 0.001, 32_000  # of the points of a cloud


def image(side: int, view: int, picture: Picture) -> bytes:
    """A picture, its JPEG untouched; `view` is the number by which the page calls it."""
    return HEADER.pack(IMAGE, side, picture.scale, view) + picture.jpeg


def matrix(
    fleet: FleetState,
    robots: Sequence[str],
    threshold_m: float,
    quantity: Quantity,
    asked: Collection[Pair],
) -> bytes:
    """Values and states of all pairs: the upper triangle by rows, in the order of the robots.

    Args:
        fleet: the server's state.
        robots: the N names in order.
        threshold_m: errors above it are hidden.
        quantity: what the values are; metres, m2, seconds or shares.
        asked: the pairs that questions are about.
    """
    n = len(robots)
    at = {robot: k for k, robot in enumerate(robots)}
    values = np.full((n, n), np.nan, np.float32)
    states = _joined(fleet, robots)
    value_of = _VALUES.get(quantity, _VALUES["rms"])
    for cell in fleet.pairs:
        a, b = at.get(cell.i), at.get(cell.j)
        if a is None or b is None:
            continue
        row, column = (a, b) if a < b else (b, a)
        states[row, column] = _bits(cell, is_shown(cell, threshold_m), int(states[row, column]))
        value = value_of(cell) if cell.state == "tried" else None
        if value is not None:
            values[row, column] = value
    for i, j in asked:
        if i in at and j in at:
            states[min(at[i], at[j]), max(at[i], at[j])] |= _ASKED
    if quantity == "sigma":
        values = _sigmas(fleet, robots)
    upper = np.triu_indices(n, 1)
    header = HEADER.pack(MATRIX, 0, n, QUANTITIES.index(quantity))
    with np.errstate(over="ignore"):  # beyond 65504 is infinite, and drawn as such
        return header + values[upper].astype("<f2").tobytes() + states[upper].tobytes()


def poses(robots: Sequence[str], known: Mapping[str, RobotPose], anchor: str | None) -> bytes:
    """x, y, heading, covariance on the ground, whether located, and the component's number of each
    robot; that of the anchor is 0. What is not known is nan.
    """
    rows = np.full((len(robots), 8), np.nan, "<f4")
    rows[:, 6] = 0
    numbers: dict[str, int] = {} if anchor is None else {_component(known, anchor): 0}
    for row, robot in zip(rows, robots, strict=True):
        pose = known.get(robot)
        if pose is None:
            continue
        number = numbers.setdefault(pose.component, len(numbers))
        spread = position_covariance(pose)
        shape = (spread[0, 0], spread[0, 1], spread[1, 1])
        row[:] = (*position(pose)[:2], heading_rad(pose), *shape, pose.located, number)
    return HEADER.pack(POSES, 0, len(robots), 0) + rows.tobytes()


def cloud(index: int, keyframe: int, T_fleet_robot: Floats, points: bytes) -> bytes:
    """One robot's points; `points` as `points_of_cloud` packs them, or that of no points for a new
    pose alone.
    """
    placed = np.asarray(T_fleet_robot[:3], "<f4").tobytes()
    return HEADER.pack(CLOUD, 0, index, keyframe & 0xFFFFFFFF) + placed + points


def points_of_cloud(points: Floats, colours: npt.NDArray[np.uint8]) -> bytes:
    """Points (M, 3) in the robot's frame, metres, and their colours (M, 3): a quantum in metres,
    then int16 of them, then bytes.
    """
    reach = float(np.abs(points).max()) if len(points) else 0.0
    quantum = max(_FINEST_M, reach / _STEPS)
    steps = np.rint(points / quantum).astype("<i2")
    return struct.pack("<f", quantum) + steps.tobytes() + colours.tobytes()


def _component(known: Mapping[str, RobotPose], anchor: str) -> str:
    return known[anchor].component if anchor in known else anchor


def _joined(fleet: FleetState, robots: Sequence[str]) -> npt.NDArray[np.uint8]:
    """(N, N) what is known of pairs that nobody speaks of: those of one component are known."""
    components = components_of(fleet)
    numbers = {c: k for k, c in enumerate(dict.fromkeys(components.values()))}
    own = np.array([numbers.get(components.get(r, ""), -1) for r in robots])
    return ((own[:, None] == own) & (own >= 0)).astype(np.uint8) * _KNOWN


def _sigmas(fleet: FleetState, robots: Sequence[str]) -> Floats:
    """(N, N) how unsure the pose of one robot in the other's is at most, metres."""
    poses = {r.robot: r.pose for r in fleet.robots if r.pose is not None}
    own = np.array([position_sigma_m(poses[r]) if r in poses else np.nan for r in robots])
    both = np.hypot(own[:, None], own[None, :])
    return np.where(_joined(fleet, robots) > 0, both, np.nan)


def _bits(cell: PairCell, shown: bool, joined: int) -> int:
    state = max(_STATES[cell.state], joined)
    clicked = _CLICKED if cell.correspondences else 0
    hidden = _HIDDEN if cell.state == "tried" and not shown else 0
    return state | _VERDICTS[cell.verdict] << 2 | clicked | hidden


_VALUES: Mapping[str, Callable[[PairCell], float | None]] = {
    "rms": lambda cell: cell.rmse_m,
    "regression": lambda cell: cell.regression_error_m2,
    "overlap": lambda cell: cell.overlap,
    "age": lambda cell: cell.age_s,
    "verdict": lambda cell: _VERDICTS[cell.verdict] / 4,
    "grave": lambda cell: cell.p_grave,
}
