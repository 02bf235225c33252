"""The error matrix: a cell per pair of robots of which anything is known."""

from pose_server.site import RobotPair, Site
from protocol.messages import PairCell, ViewName

_OLD_S = 60.0  # from then on an alignment's age is told to ten seconds


def pair_cells(site: Site, now_s: float) -> tuple[PairCell, ...]:
    """Cells of the pairs that were tried or clicked in; which others are known through others the
    poses tell. One is made anew only when it changed, its age by a second.
    """
    roots = _roots(site)
    names = sorted(
        {name for name, robot in site.robots.items() if robot.track.newest is not None}
        | {name for pair in site.book.pairs() for name in pair if name in site.robots}
    )
    clicks = {pair: len(site.book.of(*pair)) for pair in site.book.pairs()}
    cells = (
        _cell(site, (a, b), clicks.get((a, b), 0), roots, now_s)
        for k, a in enumerate(names)
        for b in names[k + 1 :]
    )
    return tuple(cell for cell in cells if cell is not None)


def _cell(
    site: Site, pair: RobotPair, clicks: int, roots: dict[str, ViewName], now_s: float
) -> PairCell | None:
    record = site.pairs.get(pair)
    best = None if record is None else record.best
    through = pair[0] in roots and roots[pair[0]] == roots.get(pair[1])
    if best is None and not clicks:
        return None
    age_s = 0.0 if record is None or best is None else max(0.0, now_s - record.last_s)
    age_s -= age_s % (1.0 if age_s < _OLD_S else 10.0)
    made_of = (best, clicks, through, age_s)
    known = site.cells.get(pair)
    if known is not None and known[0] == made_of:
        return known[1]
    a, b = pair
    if best is None:
        state = "through_others" if through else "untried"
        cell = PairCell(i=a, j=b, state=state, correspondences=clicks)
    else:
        cell = PairCell(
            i=a,
            j=b,
            state="tried",
            verdict=best.verdict,
            rmse_m=best.rmse_m,
            regression_error_m2=best.regression_error_m2,
            regression_count=best.regression_count,
            overlap=best.overlap,
            age_s=age_s,
            correspondences=clicks,
        )
    site.cells[pair] = (made_of, cell)
    return cell


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
