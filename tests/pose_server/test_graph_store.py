"""The graph on disk: what was written is there again; damage and a full disk cost it alone."""

import threading
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.persistence.graph_store import (
    Graph,
    GraphStore,
    GraphStoreError,
    read_graph,
)
from fleetpose.pose_server.persistence.graph_writer import GraphWriter, stored_graph
from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.protocol.messages import ViewName
from fleetpose.protocol.transport import wait_until

WAIT_S = 60.0


def named(robot: str, seq: int = 0) -> ViewName:
    return ViewName(robot=robot, epoch="a" * 12, seq=seq)


def edge(a: ViewName, b: ViewName, seed: int = 0, **more) -> Edge:
    rng = np.random.default_rng(seed)
    return Edge(a, b, rng.normal(size=(4, 4)), rng.normal(size=(6, 6)), **more)


def graph(robots: int, **more) -> Graph:
    views = [named(f"r{k}") for k in range(robots)]
    edges = [edge(a, b, k, **more) for k, (a, b) in enumerate(pairwise(views))]
    payloads = {view: bytes([k]) * 1000 for k, view in enumerate(views)}
    return Graph(payloads, {e.key: e for e in edges}, views[0])


def same_structure(a: Structure | None, b: Structure | None) -> bool:
    if a is None or b is None:
        return a is b
    return np.array_equal(a.centre, b.centre) and np.array_equal(a.spread, b.spread)


def same(a: Graph, b: Graph) -> bool:
    return (
        list(a.keyframes.items()) == list(b.keyframes.items())
        and a.edges.keys() == b.edges.keys()
        and a.gauge == b.gauge
        and all(
            np.array_equal(e.T_a_b, b.edges[key].T_a_b)
            and np.array_equal(e.covariance, b.edges[key].covariance)
            and (e.verdict, e.operator, e.grown)
            == (b.edges[key].verdict, b.edges[key].operator, b.edges[key].grown)
            and e.p_grave == b.edges[key].p_grave
            and same_structure(e.structure, b.edges[key].structure)
            for key, e in a.edges.items()
        )
    )


def test_a_graph_is_there_again_and_only_changes_are_written(tmp_path):
    path = tmp_path / "state" / "graph.sqlite3"
    first = graph(4, verdict="plausible", operator=True, p_grave=0.25)
    store = GraphStore(path)
    store.write(Graph(), first)
    assert same(store.read(), first) and same(read_graph(path), first)
    keyframes = {**first.keyframes, named("r9"): b"new"}
    del keyframes[named("r0")]
    edges = {k: e for k, e in first.edges.items() if named("r0") not in k}
    key = next(iter(edges))
    edges[key] = replace(edges[key], verdict="verified", grown=True)
    second = Graph(keyframes, edges, named("r1"))
    changes = store._db.total_changes
    store.write(first, second)
    # a keyframe less, one more, an edge less, one put anew, the gauge
    assert store._db.total_changes - changes == 6
    store.close()
    assert same(stored_graph(path), second)


def test_what_an_edge_rests_on_and_how_sure_it_is_comes_back_and_older_files_go_by_its_verdict(
    tmp_path,
):
    rests = Structure.of(np.random.default_rng(1).normal(size=(9, 3)))
    first = graph(3, verdict="plausible", p_grave=0.125, structure=rests)
    path = tmp_path / "graph.sqlite3"
    store = GraphStore(path)
    store.write(Graph(), first)
    for column in ("p_grave", "structure"):
        store._db.execute(f"ALTER TABLE edges DROP COLUMN {column}")
    store._db.execute("PRAGMA user_version = 1")
    store.close()
    older = graph(3, verdict="plausible")
    assert same(read_graph(path), older)
    store = GraphStore(path)
    assert same(store.read(), older)
    store.write(older, first)
    assert same(store.read(), first)
    store.close()


def test_no_file_and_no_graph_are_an_empty_one(tmp_path):
    assert same(read_graph(tmp_path / "none"), Graph())
    assert not (tmp_path / "none").exists()


def test_a_damaged_file_is_put_aside(tmp_path):
    path = tmp_path / "graph.sqlite3"
    path.write_bytes(b"no database at all" * 1000)
    assert same(stored_graph(path), Graph())
    assert (tmp_path / "damaged-graph.sqlite3").exists() and not path.exists()
    store = GraphStore(path)
    store.write(Graph(), graph(3))
    store.close()
    assert same(stored_graph(path), graph(3))


def test_the_keeper_writes_the_newest_and_ends(tmp_path):
    path, told = tmp_path / "graph.sqlite3", []
    keeper = GraphWriter(path, told.append)
    for robots in range(2, 40):
        keeper.offer(graph(robots))
    keeper.close()
    assert same(read_graph(path), graph(39)) and not told
    assert not any(thread.name == "graph keeper" for thread in threading.enumerate())


def test_a_full_disk_is_told_once_and_tried_again(tmp_path):
    path, told = tmp_path / "graph.sqlite3", []
    keeper = GraphWriter(path, told.append)
    keeper.offer(graph(3))
    assert wait_until(lambda: same(read_graph(path), graph(3)), WAIT_S)
    keeper._store._db.execute("PRAGMA max_page_count = 1").fetchone()
    large = graph(200)
    keeper.offer(large)
    assert wait_until(lambda: len(told) == 1, WAIT_S)
    assert "full" in told[0] and "clicks are not concerned" in told[0]
    keeper.offer(graph(201))
    assert same(read_graph(path), graph(3))
    keeper._store._db.execute("PRAGMA max_page_count = 1000000").fetchone()
    keeper.offer(large)
    assert wait_until(lambda: same(read_graph(path), large), WAIT_S)
    keeper.close()
    assert len(told) == 1


def test_a_graph_of_another_version_is_refused(tmp_path):
    store = GraphStore(tmp_path / "graph.sqlite3")
    store._db.execute("PRAGMA user_version = 7")
    store.close()
    with pytest.raises(GraphStoreError, match="schema 7"):
        GraphStore(tmp_path / "graph.sqlite3")


def test_a_file_of_the_first_schema_is_read_and_brought_to_the_second(tmp_path):
    path, before = tmp_path / "graph.sqlite3", graph(3, p_grave=0.25)
    store = GraphStore(path)
    store.write(Graph(), before)
    store._db.execute("ALTER TABLE edges DROP COLUMN p_grave")
    store._db.execute("ALTER TABLE edges DROP COLUMN structure")
    store._db.execute("PRAGMA user_version = 1")
    store.close()
    unknown = Graph(
        before.keyframes,
        {key: replace(e, p_grave=-1.0, structure=None) for key, e in before.edges.items()},
        before.gauge,
    )
    assert same(read_graph(path), unknown)
    store = GraphStore(path)
    assert same(store.read(), unknown)
    store.write(unknown, before)
    store.close()
    assert same(read_graph(path), before)
