"""Did an operator click something that exists only once?

Where a place repeats itself, two poses explain the images alike, and points clicked on what
repeats fit both. One on a poster, a cart, a sign fits one: under the other pose it looks different.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class UniqueSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    near_px: float = 12.0  # what a point looks like is told by a salient point so near
    clearly: float = 0.15  # less alike, as the cosine of two descriptors


UNIQUE = in_use("unique", UniqueSettings())


def on_unique_structure(
    pair: Pair, clicked: PointPairs, T_i_j: Floats, others: Sequence[Floats]
) -> bool:
    """Whether clicked points tell a pose from all others: for each of these, one of them looks like
    its partner, and not like what is in its partner's place under the other pose.

    Args:
        pair: the views.
        clicked: points in view i (a) and view j (b).
        T_i_j: the pose that they fit.
        others: the poses that the images support as well.
    """
    return all(
        any(
            _tells(pair.i, pair.j, p_i, p_j, transform(T, p_j[None])[0])
            or _tells(pair.j, pair.i, p_j, p_i, transform(inverse(T), p_i[None])[0])
            for p_i, p_j in zip(clicked.p_a, clicked.p_b, strict=True)
        )
        for T in others
    )


def _tells(
    here: PreparedView, there: PreparedView, p_here: Floats, p_there: Floats, elsewhere: Floats
) -> bool:
    """Whether a point looks like its partner in the other view, and another place of its own view,
    where that partner would be instead, does not.
    """
    partner, own, other = _look(there, p_there), _look(here, p_here), _look(here, elsewhere)
    if partner is None or own is None or not _in_sight(here, elsewhere):
        return False
    alike = float(partner @ own)
    return other is None or float(partner @ other) < alike - UNIQUE.clearly


def _in_sight(view: PreparedView, p: Floats) -> bool:
    uv, z = view.observed.project(p[None])
    return bool(z[0] > 0 and view.observed.inside(uv)[0])


def _look(view: PreparedView, p: Floats) -> npt.NDArray[np.float32] | None:
    """The descriptor nearest to where a point of the view's camera frame appears."""
    uv, z = view.observed.project(p[None])
    if z[0] <= 0 or not len(view.observed.uv):
        return None
    distance = np.linalg.norm(view.observed.uv - uv[0], axis=1)
    nearest = int(distance.argmin())
    return view.descriptors[nearest] if distance[nearest] < UNIQUE.near_px else None
