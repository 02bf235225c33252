"""The fleet's graph on disk: keyframes and the links between them, in a SQLite file of its own.

It spares a restarted server from aligning everything anew. It is no more than that: where it
cannot be written or read, the graph is made again; the operator's work in the journal is safe.
"""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.trajectory import Followed
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.pose_graph.types import Edge, EdgeKey
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]
Key = tuple[str, str, int]
_SCHEMA = 3
_UPPER = np.triu_indices(6)
_TABLES = (
    # view: encoded protocol.messages.View; in the order in which they became keyframes
    """CREATE TABLE keyframes (
        robot TEXT NOT NULL, epoch TEXT NOT NULL, seq INTEGER NOT NULL, view BLOB NOT NULL,
        PRIMARY KEY (robot, epoch, seq)
    ) STRICT""",
    # little-endian float64: T_a_b as 16 and its covariance as 36, the structure's centre and spread
    # as 12
    """CREATE TABLE edges (
        robot_a TEXT NOT NULL, epoch_a TEXT NOT NULL, seq_a INTEGER NOT NULL,
        robot_b TEXT NOT NULL, epoch_b TEXT NOT NULL, seq_b INTEGER NOT NULL,
        kind TEXT NOT NULL, verdict TEXT NOT NULL, operator INTEGER NOT NULL,
        grown INTEGER NOT NULL, T_a_b BLOB NOT NULL, covariance BLOB NOT NULL,
        p_grave REAL NOT NULL, structure BLOB,
        PRIMARY KEY (robot_a, epoch_a, seq_a, robot_b, epoch_b, seq_b, kind)
    ) STRICT""",
    """CREATE TABLE gauge (
        robot TEXT NOT NULL, epoch TEXT NOT NULL, seq INTEGER NOT NULL
    ) STRICT""",
    # where views hang: little-endian float64, the upper rows of T_keyframe_view as 12, the upper
    # triangle of its covariance as 21
    """CREATE TABLE IF NOT EXISTS followed (
        robot TEXT NOT NULL, epoch TEXT NOT NULL, seq INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
        keyframe_epoch TEXT NOT NULL, keyframe_seq INTEGER NOT NULL,
        verdict TEXT NOT NULL, way BLOB NOT NULL,
        PRIMARY KEY (robot, epoch, seq)
    ) STRICT""",
)


class GraphStoreError(FleetPoseError):
    """The graph cannot be written or read."""


@dataclass(frozen=True)
class Graph:
    """What is kept of a fleet's graph.

    Attributes:
        keyframes: encoded views, in the order in which they became keyframes.
        edges: links between them.
        gauge: the keyframe that is the fleet's origin.
        followed: where views hang on keyframes of their robot, the oldest first.
    """

    keyframes: Mapping[ViewName, bytes] = field(default_factory=dict)
    edges: Mapping[EdgeKey, Edge] = field(default_factory=dict)
    gauge: ViewName | None = None
    followed: Mapping[ViewName, Followed] = field(default_factory=dict)


class GraphStore:
    """The file. Use it from one thread at a time.

    Raises:
        GraphStoreError: it cannot be opened, or another version wrote it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = NORMAL")  # a power cut may cost the last seconds
            self._begin()
        except (OSError, sqlite3.Error) as error:
            raise GraphStoreError(f"{path}: {error}") from error

    def close(self) -> None:
        """Closes the file."""
        self._db.close()

    def write(self, before: Graph, after: Graph) -> None:
        """Writes what changed; all of it or nothing.

        Raises:
            GraphStoreError: nothing was written.
        """
        gone = [_key(view) for view in before.keyframes if view not in after.keyframes]
        new = [
            (*_key(view), encoded)
            for view, encoded in after.keyframes.items()
            if view not in before.keyframes
        ]
        lost = [_edge_key(key) for key in before.edges if key not in after.edges]
        put = [_edge_row(e) for key, e in after.edges.items() if before.edges.get(key) is not e]
        left = [_key(view) for view in before.followed if view not in after.followed]
        hung = [
            _followed_row(one)
            for view, one in after.followed.items()
            if before.followed.get(view) is not one
        ]
        try:
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")
                self._db.executemany(
                    "DELETE FROM followed WHERE (robot, epoch, seq) = (?, ?, ?)", left
                )
                self._db.executemany(
                    f"INSERT OR REPLACE INTO followed VALUES ({', '.join('?' * 8)})", hung
                )
                self._db.executemany(
                    "DELETE FROM keyframes WHERE (robot, epoch, seq) = (?, ?, ?)", gone
                )
                self._db.executemany("INSERT OR REPLACE INTO keyframes VALUES (?, ?, ?, ?)", new)
                self._db.executemany(
                    "DELETE FROM edges WHERE (robot_a, epoch_a, seq_a, robot_b, epoch_b, seq_b,"
                    " kind) = (?, ?, ?, ?, ?, ?, ?)",
                    lost,
                )
                self._db.executemany(
                    f"INSERT OR REPLACE INTO edges VALUES ({', '.join('?' * 14)})", put
                )
                if after.gauge != before.gauge:
                    self._db.execute("DELETE FROM gauge")
                    if after.gauge is not None:
                        self._db.execute("INSERT INTO gauge VALUES (?, ?, ?)", _key(after.gauge))
        except sqlite3.Error as error:
            raise GraphStoreError(f"{self.path}: {error}") from error

    def read(self) -> Graph:
        """All of it.

        Raises:
            GraphStoreError: it is damaged.
        """
        return _read(self._db, self.path)

    def clear(self) -> None:
        """Forgets all of it."""
        self.write(self.read(), Graph())

    def _begin(self) -> None:
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version == 0:
            with self._db:
                self._db.execute("BEGIN IMMEDIATE")
                for table in _TABLES:
                    self._db.execute(table)
                self._db.execute(f"PRAGMA user_version = {_SCHEMA}")
        elif version in (1, 2):
            self._from_schema(version)
        elif version != _SCHEMA:
            raise GraphStoreError(f"{self.path} has schema {version}, need {_SCHEMA}")

    def _from_schema(self, version: int) -> None:
        """Edges of which nothing is known but their verdict are worth what it stands for (-1); of
        views that are no keyframes nothing was kept.
        """
        with self._db:
            self._db.execute("BEGIN IMMEDIATE")
            if version == 1:
                self._db.execute("ALTER TABLE edges ADD COLUMN p_grave REAL NOT NULL DEFAULT -1")
                self._db.execute("ALTER TABLE edges ADD COLUMN structure BLOB")
            self._db.execute(_TABLES[-1])
            self._db.execute(f"PRAGMA user_version = {_SCHEMA}")


def read_graph(path: Path) -> Graph:
    """The graph in a file that a running server may be writing; empty where there is none.

    Raises:
        GraphStoreError: it is damaged.
    """
    if not path.exists():
        return Graph()
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as db:
            return _read(db, path)
    except sqlite3.Error as error:
        raise GraphStoreError(f"{path}: {error}") from error


def _read(db: sqlite3.Connection, path: Path) -> Graph:
    try:
        (version,) = db.execute("PRAGMA user_version").fetchone()
        if version == 0:
            return Graph()  # just made
        keyframes = {
            ViewName(robot=robot, epoch=epoch, seq=seq): encoded
            for robot, epoch, seq, encoded in db.execute("SELECT * FROM keyframes ORDER BY rowid")
        }
        edges = [_edge(row) for row in db.execute("SELECT * FROM edges ORDER BY rowid")]
        gauge = db.execute("SELECT * FROM gauge").fetchone()
        rows = db.execute("SELECT * FROM followed ORDER BY rowid") if version >= _SCHEMA else ()
        followed = {one.view: one for one in map(_followed, rows) if one.keyframe in keyframes}
    except (sqlite3.Error, ValueError) as error:
        raise GraphStoreError(f"{path}: {error}") from error
    whole = {e.key: e for e in edges if e.a in keyframes and e.b in keyframes}
    origin = None if gauge is None else _view(gauge)
    return Graph(keyframes, whole, origin if origin in keyframes else None, followed)


def _key(view: ViewName) -> Key:
    return view.robot, view.epoch, view.seq


def _view(key: Any) -> ViewName:
    return ViewName(robot=key[0], epoch=key[1], seq=key[2])


def _edge_key(key: EdgeKey) -> tuple[Any, ...]:
    return (*_key(key[0]), *_key(key[1]), key[2])


def _edge_row(edge: Edge) -> tuple[Any, ...]:
    arrays = (np.ascontiguousarray(a, "<f8").tobytes() for a in (edge.T_a_b, edge.covariance))
    flags = int(edge.operator), int(edge.grown)
    rests = None
    if edge.structure is not None:
        parts = np.vstack((edge.structure.centre, edge.structure.spread))
        rests = np.ascontiguousarray(parts, "<f8").tobytes()
    return (*_edge_key(edge.key), edge.verdict, *flags, *arrays, edge.p_grave, rests)


def _followed_row(one: Followed) -> tuple[Any, ...]:
    numbers = np.concatenate((one.T_keyframe_view[:3].ravel(), one.covariance[_UPPER]))
    way = np.ascontiguousarray(numbers, "<f8").tobytes()
    return (*_key(one.view), one.stamp_ns, *_key(one.keyframe)[1:], one.verdict, way)


def _followed(row: tuple[Any, ...]) -> Followed:
    numbers = np.frombuffer(row[7], "<f8")
    T, upper = np.eye(4), np.zeros((6, 6))
    T[:3], upper[_UPPER] = numbers[:12].reshape(3, 4), numbers[12:]
    covariance = upper + np.triu(upper, 1).T
    keyframe = _view((row[0], *row[4:6]))
    return Followed(_view(row[:3]), row[3], keyframe, T, covariance, row[6])


def _edge(row: tuple[Any, ...]) -> Edge:
    T, C = (np.frombuffer(blob, "<f8") for blob in row[10:12])
    p_grave, rests = list(row[12:]) or (-1.0, None)  # the first schema did not know them
    structure = None
    if rests is not None:
        parts = np.frombuffer(rests, "<f8").reshape(4, 3)
        structure = Structure(parts[0], parts[1:])
    return Edge(
        _view(row[0:3]),
        _view(row[3:6]),
        T.reshape(4, 4),
        C.reshape(6, 6),
        row[7],
        row[6],
        bool(row[8]),
        bool(row[9]),
        p_grave,
        structure,
    )
