"""The error matrix: a cell per pair of robots of which anything is known.

A cell tells of the last alignment. The graph may rest on better ones of earlier views: those say
where the robots are, not how well they are seen to fit now.
"""

from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import RobotPair
from fleetpose.protocol.messages import PairCell, ViewName

CellCache = dict[RobotPair, tuple[object, PairCell]]  # what a cell was made of, and the cell
_OLD_S = 60.0  # from then on an alignment's age is told to ten seconds


def pair_cells(site: Site, now_s: float, known: CellCache) -> tuple[PairCell, ...]:
    """Cells of the pairs that were tried or clicked in; which others are known through others the
    poses tell. One is made anew only when it changed, its age by a second.

    Args:
        known: cells that were made before; the new ones are put there.
    """
    roots = _roots(site)
    clicks = {pair: len(site.correspondences.of(*pair)) for pair in site.correspondences.pairs()}
    clicked = {name for pair in clicks for name in pair}
    there = {
        name
        for name, robot in site.robots.items()
        if robot.track.newest is not None or name in clicked
    }
    tried = set(site.agenda.tried)
    cells = (
        _cell(site, (a, b), clicks.get((a, b), 0), roots, now_s, known)
        for a, b in sorted(tried | clicks.keys())
        if a != b and a in there and b in there
    )
    return tuple(cell for cell in cells if cell is not None)


def _cell(
    site: Site,
    pair: RobotPair,
    clicks: int,
    roots: dict[str, ViewName],
    now_s: float,
    cache: CellCache,
) -> PairCell | None:
    record = site.pairs.get(pair)
    last = None if record is None else record.last
    through = pair[0] in roots and roots[pair[0]] == roots.get(pair[1])
    if last is None and not clicks:
        return None
    age_s = 0.0 if record is None or last is None else max(0.0, now_s - record.last_s)
    age_s -= age_s % (1.0 if age_s < _OLD_S else 10.0)
    made_of = (last, clicks, through, age_s)
    known = cache.get(pair)
    if known is not None and known[0] == made_of:
        return known[1]
    if last is None:
        state = "through_others" if through else "untried"
        cell = PairCell(i=pair[0], j=pair[1], state=state, correspondences=clicks)
    else:
        cell = _tried(pair, last, clicks, age_s)
    cache[pair] = (made_of, cell)
    return cell


def error_of(last: PairResult) -> float | None:
    """What a pair shows as its error, metres: none where its last alignment was rejected."""
    return None if last.T_i_j is None or last.verdict == "rejected" else last.rmse_m


def _tried(pair: RobotPair, last: PairResult, clicks: int, age_s: float) -> PairCell:
    rmse_m = error_of(last)
    failed = rmse_m is None
    return PairCell(
        i=pair[0],
        j=pair[1],
        state="tried",
        verdict=last.verdict,
        rmse_m=rmse_m,
        regression_error_m2=None if failed else last.regression_error_m2,
        regression_count=0 if failed else last.regression_count,
        overlap=0.0 if failed else last.overlap,
        age_s=age_s,
        correspondences=clicks,
        p_grave=None if last.T_i_j is None else last.p_grave,
        rivals=len(last.rivals),
    )


def _roots(site: Site) -> dict[str, ViewName]:
    """The root of the component that each robot is in now."""
    if site.solution is None:
        return {}
    newest = {name: robot.track.newest for name, robot in site.robots.items()}
    return {
        name: site.solution.nodes[at.keyframe].root
        for name, at in newest.items()
        if at is not None and at.keyframe in site.solution.nodes
    }
