"""A place that repeats itself fools also those pairs that cannot see it: two robots before one door
each find the same door, and nothing tells that there are twenty.

Pairs that see more of it tell: two poses look right to them. Where that happens more than now and
then, a pose to which nothing offered a rival is no surer than the place lets it be. One that beat
its rivals is: it saw what is there only once.
"""

from dataclasses import replace

from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.pose_server.state.site import Site

_LEAST_TWOFOLD = 2  # pairs of robots to which two poses look right, and
_OTHERWISE = 0.1  # a share so much larger or smaller
_LEAST_SHARE = 0.1  # of these and the verified ones: fewer are corners of a place that is unlike


def repetition(site: Site) -> float:
    """Share (0..1) of the pairs of robots that would be verified to which another pose looks right
    too, or whose pose others refuted; 0 where these are exceptions.
    """
    twofold = verified = 0
    for record in (site.pairs[pair] for pair in site.agenda.tried):
        if record.last is None:
            continue
        if record.last.twofold or record.refuted:
            twofold += 1
        elif record.last.verdict == "verified":
            verified += 1
    if twofold < _LEAST_TWOFOLD or twofold < _LEAST_SHARE * (twofold + verified):
        return 0.0
    return twofold / (twofold + verified)


def believed(site: Site) -> list[Edge]:
    """The graph's edges as far as the place lets them be believed. What is doubted is no witness
    for another one: who takes one wing for the other does so in all pairs.
    """
    share = site.set_repetition(repetition(site))
    return [_doubted(edge, share) for edge in site.edges.values()]


def _doubted(edge: Edge, share: float) -> Edge:
    sure = edge.verdict != "verified" or edge.singled_out or edge.kind != "pair" or edge.operator
    if share == 0 or sure:
        return edge
    doubt = max(edge.p_grave, share)
    return replace(edge, verdict="plausible", p_grave=doubt, structure=None)


def note_repetition(site: Site) -> None:
    """Has the fleet solved anew where its place is to be doubted otherwise than it was: also a pair
    that joins nothing tells of the others.
    """
    share = repetition(site)
    if (share > 0) != (site.repetition > 0) or abs(share - site.repetition) > _OTHERWISE:
        site.want_solution()


def note_refuted(site: Site) -> None:
    """Remembers which pairs of robots have a verified edge that the solution set aside, until they
    are aligned anew: once all are doubted, no solution sets one aside again.
    """
    assert site.solution is not None
    for key, edge in site.edges.items():
        said = site.solution.edges.get(key)
        if edge.verdict == "verified" and edge.kind == "pair" and said is not None and said.outlier:
            site.pair(edge.a.robot, edge.b.robot).refute()
