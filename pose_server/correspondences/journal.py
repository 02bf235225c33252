"""What outlives the server: one SQLite file, written ahead and synced, owned by one process.

Each public method is one transaction; when it returns, a `kill -9` or a power cut loses nothing of
it. When it raises, nothing of it was written.
"""

import fcntl
import os
import sqlite3
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, TypeVar

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.correspondences.records import (
    MAX_REJECTIONS,
    BookState,
    Change,
    JournalError,
    Kept,
    Progress,
)
from fleetpose.pose_server.correspondences.schema import MIGRATIONS
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import Correspondence, ImageHeader, Rejection, ViewName

__all__ = ["Journal", "JournalError", "StoredView"]

Floats = npt.NDArray[np.floating]
Row = tuple[Any, ...]
T = TypeVar("T")
_BUSY_TIMEOUT_S = 2.0  # somebody looks into the file with another program
_NEXT_ID = "next_correspondence"


@dataclass(frozen=True)
class StoredView:
    """A view that was clicked in: its encoded `View`, and its JPEG once that was fetched."""

    name: ViewName
    encoded: bytes
    jpeg: bytes | None = None
    header: ImageHeader | None = None


class Journal:
    """The journal of one server; may be used from several threads.

    Args:
        path: the SQLite file; it and its folder are made where missing. One of an older schema is
            brought up to date; a copy stays beside it.
        migrations: the schema's versions, for tests.

    Raises:
        JournalError: another process has it, or it cannot be read.
    """

    def __init__(self, path: Path, migrations: Sequence[Sequence[str]] = MIGRATIONS) -> None:
        self.path = path
        self._guard = threading.RLock()
        self._lock = _locked(path)
        try:
            self._db = _opened(path)
            _keep_copy(self._db, migrations, path)
            with self._transaction():
                _migrate(self._db, migrations, path)
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> "Journal":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file and lets another process have it."""
        with self._guard:
            self._db.close()
            self._lock.close()

    # the book

    def record(self, change: Change) -> None:
        """Writes all that an operator's update does.

        Raises:
            JournalError: nothing was written.
        """
        with self._transaction() as db:
            _count_up(db, change)
            if change.rejection is not None:
                _reject(db, change)
                return
            db.execute(
                "INSERT INTO pairs VALUES (?, ?, ?)"
                " ON CONFLICT DO UPDATE SET revision = excluded.revision",
                (*change.pair, change.revision),
            )
            db.executemany(
                "DELETE FROM correspondences WHERE id = ?", ((n,) for n in change.erased)
            )
            if change.put is not None:
                db.execute(
                    f"INSERT OR REPLACE INTO correspondences VALUES ({', '.join('?' * 17)})",
                    _row(change.put),
                )
            _put_meta(db, _NEXT_ID, str(change.next_id))
            for view, encoded in change.views.items():
                db.execute(
                    "INSERT OR IGNORE INTO views (robot, epoch, seq, view) VALUES (?, ?, ?, ?)",
                    (*_key(view), encoded),
                )

    def load(self) -> BookState:
        """The operator's work.

        Raises:
            JournalError: the file is damaged.
        """
        with self._transaction() as db:
            rows = db.execute("SELECT * FROM correspondences ORDER BY id").fetchall()
            revisions = {(i, j): n for i, j, n in db.execute("SELECT * FROM pairs")}
            rejections: dict[tuple[str, str], list[Rejection]] = {}
            for operator, session, n, reason in db.execute("SELECT * FROM rejections ORDER BY n"):
                rejections.setdefault((operator, session), []).append(Rejection(n=n, reason=reason))
            sessions = {
                (operator, session): Progress(n, tuple(rejections.get((operator, session), ())))
                for operator, session, n in db.execute("SELECT * FROM sessions")
            }
            next_id = int(_get_meta(db, _NEXT_ID) or 0)
        return BookState(self._read(_kept, rows), revisions, sessions, next_id)

    # views that were clicked in

    def keep_view(self, view: StoredView) -> None:
        """Writes a view, or adds the JPEG to one that is there."""
        header = None if view.header is None else pack(view.header)
        with self._transaction() as db:
            db.execute(
                "INSERT INTO views VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT DO UPDATE SET"
                " jpeg = coalesce(excluded.jpeg, jpeg), header = coalesce(excluded.header, header)",
                (*_key(view.name), view.encoded, view.jpeg, header),
            )

    def view(self, name: ViewName) -> StoredView | None:
        """One view, or None if it is not in the journal."""
        with self._transaction() as db:
            rows = db.execute(
                "SELECT * FROM views WHERE (robot, epoch, seq) = (?, ?, ?)", _key(name)
            ).fetchall()
        return next(iter(self._read(_stored_view, rows)), None)

    def views(self) -> tuple[StoredView, ...]:
        """All views."""
        with self._transaction() as db:
            rows = db.execute("SELECT * FROM views ORDER BY rowid").fetchall()
        return self._read(_stored_view, rows)

    def keep_only_views(self, names: Collection[ViewName]) -> int:
        """Drops all other views; how many."""
        wanted = {_key(name) for name in names}
        with self._transaction() as db:
            there = db.execute("SELECT robot, epoch, seq FROM views").fetchall()
            gone = [key for key in there if key not in wanted]
            db.executemany("DELETE FROM views WHERE (robot, epoch, seq) = (?, ?, ?)", gone)
        return len(gone)

    # what else must not be forgotten: the anchor, the gauge's revision

    def note(self, **values: str) -> None:
        """Writes named values."""
        with self._transaction() as db:
            for name, value in values.items():
                _put_meta(db, name, value)

    def noted(self, name: str) -> str | None:
        """A named value, or None."""
        with self._transaction() as db:
            return _get_meta(db, name)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._guard:
            try:
                self._db.execute("BEGIN IMMEDIATE")
                yield self._db
                self._db.execute("COMMIT")
            except sqlite3.Error as error:
                raise JournalError(
                    f"journal {self.path}: {error}; nothing was written, check the disk and "
                    "whether another program holds the file"
                ) from error
            finally:
                self._roll_back()

    def _roll_back(self) -> None:
        """Ends a transaction that was not committed."""
        try:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")
        except sqlite3.Error:
            return  # the error that led here is the one to tell; reopening rolls back

    def _read(self, decode: Callable[[Row], T], rows: Iterable[Row]) -> tuple[T, ...]:
        try:
            return tuple(decode(row) for row in rows)
        except (CodecError, ValueError) as error:
            raise JournalError(
                f"journal {self.path}: a record is damaged: {error}; restore the file from a copy, "
                "or move it away to begin a new one"
            ) from error


def _locked(path: Path) -> IO[str]:
    """Locks the file beside the journal; it names the owner, and is free when that ends."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.with_name(path.name + ".lock").open("a+")
    except OSError as error:
        raise JournalError(f"journal {path} cannot be made: {error}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.seek(0)
        owner = lock.read().strip() or "unknown"
        lock.close()
        raise JournalError(
            f"journal {path} is in use by process {owner}: end it, or choose another --state-dir"
        ) from None
    lock.truncate(0)
    lock.write(str(os.getpid()))
    lock.flush()
    return lock


def _opened(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(
        path, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
    )
    try:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        db.execute("PRAGMA foreign_keys = ON")
    except sqlite3.Error as error:
        db.close()
        raise JournalError(
            f"journal {path} cannot be read: {error}; move it away to begin a new one"
        ) from error
    return db


def _keep_copy(db: sqlite3.Connection, migrations: Sequence[Sequence[str]], path: Path) -> None:
    """A journal that is about to be migrated stays as it was in a file beside it.

    Raises:
        JournalError: it cannot be written; the journal is not touched then.
    """
    (version,) = db.execute("PRAGMA user_version").fetchone()
    copy = path.with_name(f"{path.name}.schema{version}")
    if not 0 < version < len(migrations) or copy.exists():
        return
    unfinished = copy.with_name(f"{copy.name}.part")
    try:
        unfinished.unlink(missing_ok=True)
        with closing(sqlite3.connect(unfinished)) as target:
            db.backup(target)
        unfinished.rename(copy)
    except (OSError, sqlite3.Error) as error:
        raise JournalError(
            f"journal {path} has schema {version} and must be brought to {len(migrations)}, but a "
            f"copy cannot be written beside it: {error}; make room and start again"
        ) from error


def _migrate(db: sqlite3.Connection, migrations: Sequence[Sequence[str]], path: Path) -> None:
    """Brings an older journal to the newest schema."""
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if version > len(migrations):
        raise JournalError(
            f"journal {path} has schema {version}, this server knows {len(migrations)}: "
            "use the newer server that wrote it, or another --state-dir"
        )
    for statements in migrations[version:]:
        for statement in statements:
            db.execute(statement)
    db.execute(f"PRAGMA user_version = {len(migrations)}")


def _count_up(db: sqlite3.Connection, change: Change) -> None:
    """Sessions advance by one: what is written already is never written again."""
    db.execute("INSERT OR IGNORE INTO sessions VALUES (?, ?, 0)", change.session)
    advanced = db.execute(
        "UPDATE sessions SET n = ? WHERE operator = ? AND session = ? AND n = ?",
        (change.n, *change.session, change.n - 1),
    )
    if advanced.rowcount != 1:
        raise JournalError(f"update {change.n} of {change.session[0]} does not follow the last one")


def _reject(db: sqlite3.Connection, change: Change) -> None:
    db.execute(
        "INSERT INTO rejections VALUES (?, ?, ?, ?)", (*change.session, change.n, change.rejection)
    )
    db.execute(
        "DELETE FROM rejections WHERE operator = ?1 AND session = ?2 AND n NOT IN (SELECT n FROM"
        " rejections WHERE operator = ?1 AND session = ?2 ORDER BY n DESC LIMIT ?3)",
        (*change.session, MAX_REJECTIONS),
    )


def _put_meta(db: sqlite3.Connection, name: str, value: str) -> None:
    db.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (name, value))


def _get_meta(db: sqlite3.Connection, name: str) -> str | None:
    row = db.execute("SELECT value FROM meta WHERE name = ?", (name,)).fetchone()
    return None if row is None else row[0]


def _key(view: ViewName) -> tuple[str, str, int]:
    return (view.robot, view.epoch, view.seq)


def _row(kept: Kept) -> Row:
    item = kept.item
    ends = (
        (item.view_i.epoch, item.view_i.seq, *map(float, item.pixel_i)),
        (item.view_j.epoch, item.view_j.seq, *map(float, item.pixel_j)),
    )
    arrays = (
        np.ascontiguousarray(a, "<f8").tobytes() for a in (kept.p_i, kept.C_i, kept.p_j, kept.C_j)
    )
    robots = (item.view_i.robot, item.view_j.robot)
    return (item.id, *robots, item.operator, item.revision, *ends[0], *ends[1], *arrays)


def _kept(row: Row) -> Kept:
    number, i, j, operator, revision, epoch_i, seq_i, u_i, v_i, epoch_j, seq_j, u_j, v_j = row[:13]
    item = Correspondence(
        id=number,
        operator=operator,
        view_i=ViewName(robot=i, epoch=epoch_i, seq=seq_i),
        view_j=ViewName(robot=j, epoch=epoch_j, seq=seq_j),
        pixel_i=np.array([u_i, v_i]),
        pixel_j=np.array([u_j, v_j]),
        revision=revision,
    )
    p_i, C_i, p_j, C_j = (np.frombuffer(blob, "<f8") for blob in row[13:])
    return Kept(item, p_i, C_i.reshape(3, 3), p_j, C_j.reshape(3, 3))


def _stored_view(row: Row) -> StoredView:
    robot, epoch, seq, encoded, jpeg, header = row
    name = ViewName(robot=robot, epoch=epoch, seq=seq)
    return StoredView(name, encoded, jpeg, None if header is None else unpack(ImageHeader, header))
