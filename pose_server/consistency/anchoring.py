"""Where the fleet's origin is: a keyframe of the anchor, and another one once the fleet has left.

The origin stays where it is as long as a robot sees its part of the map. Where none does while some
see each other elsewhere, they are the fleet: one of their keyframes becomes the origin. The old map
stays a component of its own, robots that come back hang on it, and its origin is taken again if all
of them do.
"""

from collections import defaultdict
from collections.abc import Sequence

from fleetpose.pose_server.consistency.doubts import why_doubted
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import Alarm, ViewName

PATIENCE_S = 5.0  # as long as a pose counts as fresh: so long nobody was located


def gauge_of(site: Site, nodes: Sequence[ViewName]) -> ViewName | None:
    """The anchor's first keyframe; it stays the origin until the fleet has left it."""
    if site.gauge in nodes and site.gauge is not None and site.gauge.robot == site.anchor:
        return site.gauge
    return next((node for node in nodes if node.robot == site.anchor), None)


def choose_anchor(site: Site) -> None:
    """The first robot by name of the largest component of two or more; once chosen it stays."""
    if site.anchor is not None or site.solution is None:
        return
    fleets = [{view.robot for view in views} for views in site.solution.components.values()]
    largest = max(fleets, key=len)
    if len(largest) > 1:
        site.set_anchor(min(largest))
        site.say(f"{site.anchor} is the anchor: the fleet's origin")


def note_anchor(site: Site, now_s: float) -> None:
    """Moves the origin to where the fleet is once it has left the old one for some seconds, and
    says when the robot that is to be the anchor was never seen.
    """
    _note_absent(site, now_s)
    anchoring, fleets = site.anchoring, _fleets(site, now_s)
    elsewhere = {root: names for root, names in fleets.items() if len(names) > 1}
    origin = None
    if site.solution is not None and site.gauge is not None:
        origin = site.solution.nodes.get(site.gauge)
    if origin is None or origin.root in fleets or not elsewhere:
        anchoring.is_seen()
    elif anchoring.has_left(now_s, PATIENCE_S):
        root = max(elsewhere, key=lambda one: len(elsewhere[one]))
        _move(site, root, elsewhere[root])


def why_apart(site: Site, robot: Robot) -> str:
    """Why a robot is not joined to the fleet's origin."""
    if site.anchoring.missing:
        return site.anchoring.missing
    others = [other for other in site.robots.values() if other is not robot and other.newest]
    if site.gauge is None and not others:
        return (
            "it is the only robot so far: the fleet begins, and has an origin, when a second one "
            "is joined to it"
        )
    if site.gauge is None:
        return "no two robots are joined by a verified alignment yet, so that there is no fleet yet"
    if _sees_an_old_place(site, robot):
        return (
            "it sees a place that the fleet has left, and is found on the map of it; nothing joins "
            "that map to where the fleet is now"
        )
    if robot.name == site.anchor:
        return (
            "it is the anchor, but where it is now nothing joins it to the fleet's origin: where "
            f"its view {site.gauge.seq} was taken"
        )
    return "no verified alignment joins it to the fleet's origin, directly or through others"


def anchor_alarms(site: Site) -> tuple[Alarm, ...]:
    """That the robot that is to be the anchor was never seen."""
    if not site.anchoring.missing or site.anchor is None:
        return ()
    return (Alarm(robot=site.anchor, kind="anchor", text=site.anchoring.missing),)


def _sees_an_old_place(site: Site, robot: Robot) -> bool:
    newest, solution = robot.track.newest, site.solution
    if newest is None or solution is None:
        return False
    return any(solution.joined(newest.keyframe, origin) for origin in site.anchoring.origins)


def _note_absent(site: Site, now_s: float) -> None:
    """An anchor that has no keyframe although other robots have some: the one that was asked for is
    waited for and named; one of an earlier time is given up.
    """
    anchoring = site.anchoring
    seen = sorted(name for name, robot in site.robots.items() if robot.track.keyframes)
    if site.anchor is None or site.anchor in seen or not seen:
        anchoring.is_there()
        return
    if anchoring.waits(now_s) < PATIENCE_S / 2:  # it may come as the others did
        return
    if site.anchor != anchoring.asked:
        site.say(
            f"{site.anchor} was the anchor before and is not there: the fleet gets another one"
        )
        site.set_anchor(None)
        site.raise_revision()
    elif not anchoring.missing:
        anchoring.miss(_missing_text(site, site.anchor, seen))
        site.say(anchoring.missing)


def _missing_text(site: Site, anchor: str, seen: Sequence[str]) -> str:
    what = f"no robot called {anchor} has been seen"
    if anchor in site.robots:
        what = f"no view of {anchor} has arrived"
    return (
        f"{what}, and it is to be the anchor; known: {', '.join(seen)}. The fleet waits for it: "
        "start it, or start the server with another --anchor"
    )


def _fleets(site: Site, now_s: float) -> dict[ViewName, list[str]]:
    """The robots whose newest view is fresh and believed, by the root of the component they see."""
    found: dict[ViewName, list[str]] = defaultdict(list)
    for name, robot in sorted(site.robots.items()):
        newest = robot.track.newest
        if site.solution is None or newest is None or not robot.alive or why_doubted(site, robot):
            continue
        kept, node = site.views.get(newest.view), site.solution.nodes.get(newest.keyframe)
        if kept is not None and node is not None and now_s - kept.received_s < PATIENCE_S:
            found[node.root].append(name)
    return found


def _move(site: Site, root: ViewName, robots: Sequence[str]) -> None:
    """The origin is in another component from now on: where it was there before, else at the first
    keyframe of the robot that was asked for, of the anchor, or of the first one by name.
    """
    assert site.solution is not None and site.gauge is not None
    left, component = site.gauge, site.solution.components[root]
    here = [view for view in site.keyframes() if view in set(component)]
    before = [view for view in site.anchoring.origins if view in component]
    preferred = [name for name in (site.anchoring.asked, site.anchor) if name in robots]
    name = preferred[0] if preferred else robots[0]
    origin = before[-1] if before else next(view for view in here if view.robot == name)
    site.set_gauge(origin)
    site.set_anchor(origin.robot)
    site.anchoring.move(left, origin)
    again = "again" if before else "from now on"
    site.say(
        f"no robot sees the fleet's old place any more, and {', '.join(robots)} see each other: "
        f"{site.anchor} is the anchor {again}, and poses are of another frame than before; the map "
        f"of the old place stays, and robots that come back there are found on it"
    )
