"""Writes the fleet's graph down while the server works, in a thread of its own."""

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from fleetpose.pose_server.persistence.graph_store import Graph, GraphStore, GraphStoreError
from fleetpose.pose_server.state.site import Site

log = logging.getLogger("pose_server")

_CLOSE_S = 2.0


class GraphWriter:
    """Keeps the newest graph that it was given; an older one that still waits is dropped for it.

    Args:
        path: the file.
        tell: called once with a sentence when it cannot be written, from the keeper's thread.
    """

    def __init__(self, path: Path, tell: Callable[[str], None]) -> None:
        self._path, self._tell = path, tell
        self._changed = threading.Condition()
        self._next: Graph | None = None
        self._closed = False
        self._told = False
        self._store: GraphStore | None = None
        self._written = Graph()
        self._thread = threading.Thread(target=self._run, name="graph keeper", daemon=True)
        self._thread.start()

    def offer(self, graph: Graph) -> None:
        """Has a graph written as soon as the last one is."""
        with self._changed:
            self._next = graph
            self._changed.notify()

    def close(self) -> None:
        """Writes what waits, within a time, and ends."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._next is not None)
                graph, self._next = self._next, None
            if graph is None:
                break
            try:
                self._write(graph)
                self._told = False
            except GraphStoreError as error:
                self._failed(error)
        if self._store is not None:
            self._store.close()

    def _write(self, graph: Graph) -> None:
        if self._store is None:
            self._store = GraphStore(self._path)
            self._written = self._store.read()
        self._store.write(self._written, graph)
        self._written = graph

    def _failed(self, error: GraphStoreError) -> None:
        """The next graph is tried again: there may be room then."""
        log.error("the graph is not kept: %s", error)
        if not self._told:
            self._told = True
            self._tell(
                f"the graph cannot be written: {error}; clicks are not concerned, but after a "
                "restart all pairs are aligned anew"
            )


def graph_of(site: Site) -> Graph:
    """What a site knows now; views are shared, not copied."""
    views = (site.views.get(keyframe) for keyframe in site.keyframes())
    keyframes = {view.name: view.payload for view in views if view is not None}
    followed = {
        view: one
        for robot in site.robots.values()
        for view, one in robot.track.trajectory.views.items()
        if one.keyframe in keyframes
    }
    return Graph(keyframes, dict(site.edges), site.gauge, followed)


def stored_graph(path: Path) -> Graph:
    """The graph that an earlier life left; a file that cannot be read is put aside."""
    try:
        store = GraphStore(path)
        try:
            return store.read()
        finally:
            store.close()
    except GraphStoreError as error:
        log.error("the graph is made anew: %s", error)
        for file in path.parent.glob(f"{path.name}*"):
            file.rename(file.with_name(f"damaged-{file.name}"))
        return Graph()
