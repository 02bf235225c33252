"""What must not change under bad input: everything the server has told and written down."""

import hashlib
import sqlite3
import threading
from pathlib import Path
from typing import Any

from fleetpose.evaluation.system.observer import Observer
from fleetpose.hmi_client.network.message_decoder import opened
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import PairCorrespondences, Receipts, RobotPose
from fleetpose.protocol.transport import Link, Sample

Fingerprint = dict[str, Any]
_TABLES = ("correspondences", "pairs", "sessions", "rejections")


class Ear:
    """Keeps the newest good sample of every key, and the newest set of every pair."""

    def __init__(self, link: Link, keys: Keys, robots: tuple[str, ...]) -> None:
        self._lock = threading.Lock()
        self._heard: dict[str, Sample] = {}
        self.deaf = False
        for key in (
            *(keys.state, keys.status, keys.poses, keys.camera("*")),
            *(keys.alignment("*", "*"), keys.correspondences("*", "*"), keys.receipts("*")),
        ):
            link.on_latched(key, self._store)
        self._bulk = [link.subscribe_bulk(keys.cloud(robot), self._store) for robot in robots]
        self._bulk += [link.subscribe_bulk(keys.image(robot), self._store) for robot in robots]

    def heard(self) -> dict[str, Sample]:
        """By key."""
        with self._lock:
            return dict(self._heard)

    def stop(self) -> None:
        """Hears no more, so that what is kept is good."""
        with self._lock:
            self.deaf = True
        for subscriber in self._bulk:
            subscriber.undeclare()

    def _store(self, sample: Sample) -> None:
        with self._lock:
            if not self.deaf:
                self._heard[sample.key] = sample


class Told:
    """The sets and receipts of the server, whatever else is said under their keys."""

    def __init__(self, link: Link, keys: Keys, server_epoch: str) -> None:
        self._keys, self._epoch = keys, server_epoch
        self._lock = threading.Lock()
        self._messages: dict[str, Any] = {}
        for key in (keys.correspondences("*", "*"), keys.receipts("*"), keys.poses):
            link.on_latched(key, self._store)

    def _store(self, sample: Sample) -> None:
        try:
            message = opened(self._keys, sample)
        except FleetPoseError:
            return
        if not isinstance(message, PairCorrespondences | Receipts | RobotPose):
            return
        if message.server_epoch == self._epoch:
            with self._lock:
                self._messages[_name(message)] = _content(message)

    def fingerprint(self) -> Fingerprint:
        """The newest of each, without what changes with time."""
        with self._lock:
            return dict(self._messages)


def fingerprint(told: Told, observer: Observer, journal: Path) -> Fingerprint:
    """All that bad input could change: robots, components, verdicts, correspondences, receipts,
    pins and the journal.
    """
    state = observer.state
    found = told.fingerprint() | {"journal": _digest(journal)}
    if state is not None:
        found["server"] = state.server_epoch
        found["anchor"] = (state.anchor, state.gauge_revision)
        found["robots"] = sorted(robot.robot for robot in state.robots)
        found["pinned"] = sorted(str(view) for view in state.pinned)
        found["clicks"] = sorted(
            (cell.i, cell.j, cell.correspondences) for cell in state.pairs if cell.correspondences
        )
    return found


def changes(before: Fingerprint, after: Fingerprint) -> list[str]:
    """What differs."""
    names = sorted({*before, *after})
    return [
        f"{name}: {before.get(name)} -> {after.get(name)}"
        for name in names
        if before.get(name) != after.get(name)
    ]


def _name(message: PairCorrespondences | Receipts | RobotPose) -> str:
    if isinstance(message, PairCorrespondences):
        return f"set {message.i} {message.j}"
    if isinstance(message, Receipts):
        return f"receipts {message.operator}/{message.session}"
    return f"pose {message.robot}"


def _content(message: PairCorrespondences | Receipts | RobotPose) -> Any:
    if isinstance(message, PairCorrespondences):
        picks = [
            (c.id, str(c.view_i), str(c.view_j), *c.pixel_i, *c.pixel_j, c.revision)
            for c in message.items
        ]
        return message.revision, sorted(picks)
    if isinstance(message, Receipts):
        return message.n, len(message.rejections)
    return message.component, message.verdict


def _digest(journal: Path) -> str:
    """Of the operator's work as it is written down."""
    digest = hashlib.sha256()
    db = sqlite3.connect(f"file:{journal}?mode=ro", uri=True, timeout=5.0)
    try:
        for table in _TABLES:
            for row in db.execute(f"SELECT * FROM {table} ORDER BY 1, 2, 3"):
                digest.update(repr(row).encode())
    finally:
        db.close()
    return digest.hexdigest()
