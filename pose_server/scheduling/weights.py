"""How much a pair of robots deserves the next alignment, beside the others of its line.

The method's paper has its scheduler weigh four things: the time since the last alignment, the
relative pose that is known, the regression error and the operator's correspondences. The time is in
`weighted_round_robin`; the pose is in the line and in what a pair promises (`proposals`); the other
two are here.
"""

from fleetpose.pose_server.registration.operator_starts import FULL_POSE
from fleetpose.pose_server.scheduling.settings import Line
from fleetpose.pose_server.state.pairs import PairRecord
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import RobotPair

_LEAST_PROMISE = 0.05  # looks deceive: no pair is hopeless
_WRONG_NEEDS = 3.0  # a pair whose best alignment is not trusted needs more than its share
_ERROR_SHARE = 0.01  # of the depth: an error that adds the pair's own weight once


def pair_weight(
    site: Site, pair: RobotPair, record: PairRecord, line: Line, promise: float
) -> float:
    """What a pair promises, more for the operator's correspondences, for a large last error and for
    a result that is not trusted, less for every link it has and for every try that failed.
    """
    weight = _LEAST_PROMISE + promise
    weight *= 1.0 + site.weights.clicks * min(live_clicks(site, pair, record) / FULL_POSE, 1.0)
    weight *= 1.0 + _by_error(site, record)
    best = record.best
    if line == "sharpening":
        weight /= 1.0 + site.edge_count(*pair)
        if best is not None and best.verdict != "verified":
            weight *= _WRONG_NEEDS
    elif best is not None and best.verdict == "rejected":
        weight /= 1.0 + 0.5 * record.alignments  # tries so far
    return weight


def live_clicks(site: Site, pair: RobotPair, record: PairRecord) -> int:
    """Correspondences of a pair that are neither erased nor contradicted by the images."""
    items = (kept.item for kept in site.correspondences.of(*pair))
    return sum(record.heard.get((item.id, item.revision)) is not False for item in items)


def _by_error(site: Site, record: PairRecord) -> float:
    """What the error of the last alignment adds; one that failed has none."""
    last = record.last
    if last is None or last.verdict == "rejected":
        return 0.0
    return min(last.rmse_m / (_ERROR_SHARE * site.depth_m), site.weights.error)
