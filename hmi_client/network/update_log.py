"""The operator's updates on disk until the server has receipted them: a client that was killed goes
on where it was.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import OperatorUpdate

_VERSION = 1
_TABLES = """
CREATE TABLE life (session TEXT, confirmed INTEGER, confirmed_by TEXT);
CREATE TABLE updates (n INTEGER PRIMARY KEY, payload BLOB);
"""


@dataclass(frozen=True)
class Life:
    """A client's session as it was left.

    Attributes:
        session: its epoch.
        confirmed: the highest number that was receipted, by the server of epoch `confirmed_by`.
        updates: those that were not, in order.
    """

    session: str
    confirmed: int
    confirmed_by: str | None
    updates: tuple[OperatorUpdate, ...]


class UpdateLog:
    """One operator's file. Not more than one client has it at a time.

    It outlives a crash of the client. That of the machine may take the last clicks with it: waiting
    for the disk at every click would be felt.

    Raises:
        OperatorError: the file cannot be used, or another client has it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._explained():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, timeout=0.0, check_same_thread=False)
            self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = NORMAL")
            (version,) = self._db.execute("PRAGMA user_version").fetchone()
            if version == 0:
                self._db.executescript(f"{_TABLES}PRAGMA user_version = {_VERSION};")
            elif version != _VERSION:
                raise OperatorError(f"{path} is of another version ({version}): move it away")

    def life(self) -> Life | None:
        """What the last client left, None if there was none.

        Raises:
            OperatorError: it is damaged.
        """
        with self._explained():
            row = self._db.execute("SELECT session, confirmed, confirmed_by FROM life").fetchone()
            payloads = self._db.execute("SELECT payload FROM updates ORDER BY n").fetchall()
            if row is None:
                return None
            updates = tuple(unpack(OperatorUpdate, payload) for (payload,) in payloads)
        session, confirmed, confirmed_by = row
        return Life(session, confirmed, confirmed_by, updates)

    def begin(self, life: Life) -> None:
        """Keeps a session in place of what was there."""
        rows = [(update.n, pack(update)) for update in life.updates]
        with self._explained(), self._db:
            self._db.execute("DELETE FROM updates")
            self._db.execute("DELETE FROM life")
            who = (life.session, life.confirmed, life.confirmed_by)
            self._db.execute("INSERT INTO life VALUES (?, ?, ?)", who)
            self._db.executemany("INSERT INTO updates VALUES (?, ?)", rows)

    def keep(self, update: OperatorUpdate) -> None:
        """Keeps an update until it is settled."""
        with self._explained(), self._db:
            self._db.execute("REPLACE INTO updates VALUES (?, ?)", (update.n, pack(update)))

    def settle(self, confirmed: int, confirmed_by: str | None) -> None:
        """Lets go of what was receipted."""
        with self._explained(), self._db:
            self._db.execute("DELETE FROM updates WHERE n <= ?", (confirmed,))
            by = (confirmed, confirmed_by)
            self._db.execute("UPDATE life SET confirmed = ?, confirmed_by = ?", by)

    def close(self) -> None:
        """Lets another client have the file."""
        self._db.close()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError, CodecError) as error:
            raise OperatorError(f"{self._path} cannot be used: {error}") from error
