"""A server that begins again where the one before it ended."""

import logging
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np

from fleetpose.pose_server.consistency.levelling import levels_text, recall_levels
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose
from fleetpose.pose_server.frontend.trajectory import Followed
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.persistence.graph_store import Graph
from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.pose_server.scheduling import pair_queue
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.pose_server.settings import RecipeName
from fleetpose.pose_server.state.origins import Anchoring
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView, open_view
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import ViewName

log = logging.getLogger("pose_server")

JOURNAL, GRAPH = "journal.sqlite3", "graph.sqlite3"  # in the server's state folder
_FULL_POSE = 3


class SiteSettings(TypedDict, total=False):
    """What a site is told by its settings."""

    located_sigma: float
    located_grave: float
    recipe: RecipeName
    icp: IcpMethod
    weights: Weights


def restored_site(
    journal: Journal,
    graph: Graph,
    skip: frozenset[tuple[str, str]] = frozenset(),
    anchor: str | None = None,
    **settings: Unpack[SiteSettings],
) -> Site:
    """A site as the journal and the graph of an earlier life tell of it.

    Raises:
        JournalError: the journal cannot be read.
    """
    before = journal.noted("anchor") or None
    revision = int(journal.noted("gauge_revision") or 0)
    site = Site(
        correspondences=CorrespondenceStore(journal),
        skip=skip,
        anchor=anchor or before,
        gauge_revision=revision + (anchor is not None and before not in (None, anchor)),
        anchoring=Anchoring(anchor),
        **settings,
    )
    now_s = time.monotonic()
    encoded = {**graph.keyframes, **{stored.name: stored.encoded for stored in journal.views()}}
    views = [view for name, data in encoded.items() if (view := _opened(name, data, now_s))]
    restore(site, views, graph.edges.values(), graph.gauge, graph.followed)
    recall_levels(site, journal.noted("levels") or "[]")
    return site


def note_frame(journal: Journal, site: Site) -> None:
    """Writes down what the fleet's frame is, so that after a restart it is not silently another.

    Raises:
        JournalError: it cannot be written.
    """
    journal.note(
        anchor=site.anchor or "",
        gauge_revision=str(site.gauge_revision),
        levels=levels_text(site),
    )


def restore(
    site: Site,
    keyframes: Sequence[KeptView],
    edges: Iterable[Edge] = (),
    gauge: ViewName | None = None,
    followed: Mapping[ViewName, Followed] = {},
) -> None:
    """Keyframes and their links are there again, and so are the views that were clicked in, which
    hang where they hung; all pairs that were clicked in are due.
    """
    known = {view.name for view in keyframes}
    for view in keyframes:
        robot = site.robot(view.name.robot)
        site.views.keep(view)
        here = _hung(followed.get(view.name), known)
        if here is not None:
            robot.track.recall_at(here)
            continue
        robot.track.recall(view.name)
        pair_queue.note_keyframe(site, view.name)
    by_robot: dict[str, dict[ViewName, Followed]] = {}
    for view, one in followed.items():
        if one.keyframe in known:
            by_robot.setdefault(view.robot, {})[view] = one
    for robot_name, own in by_robot.items():
        site.robot(robot_name).track.trajectory.recall(own)
    for edge in edges:
        known = edge.a in site.views and edge.b in site.views
        if known and (not edge.operator or _is_confirmed(site, edge)):
            site.link(edge)
            if edge.kind == "pair":
                site.pair(edge.a.robot, edge.b.robot).note_tried((edge.a, edge.b), "pair")
    site.set_gauge(gauge if gauge is not None and gauge in site.views else None)
    for pair in site.correspondences.pairs():
        site.pair(*pair).make_due("clicks")
    if keyframes:
        site.want_solution()


def _hung(one: Followed | None, known: Collection[ViewName]) -> KeyframeRelativePose | None:
    """Where a view hangs on another one that is known as well."""
    if one is None or one.keyframe == one.view or one.keyframe not in known:
        return None
    if not np.isfinite(one.covariance).all():
        return None
    return KeyframeRelativePose(
        one.view, one.keyframe, one.T_keyframe_view, one.covariance, one.verdict
    )


def folder_files(state_dir: Path) -> tuple[Path, Path]:
    """The journal and the graph of a state folder."""
    return state_dir / JOURNAL, state_dir / GRAPH


def _is_confirmed(site: Site, edge: Edge) -> bool:
    """Whether the clicks that an edge rests on are still there: they may have been erased after it
    was written last.
    """
    return len(site.correspondences.of(edge.a.robot, edge.b.robot)) >= _FULL_POSE


def _opened(name: ViewName, encoded: bytes, now_s: float) -> KeptView | None:
    """A stored view; one that cannot be read costs that view, not the server."""
    try:
        return open_view(encoded, None, now_s)
    except CodecError as error:
        log.error("stored view %s is left out: %s", name, error)
        return None
