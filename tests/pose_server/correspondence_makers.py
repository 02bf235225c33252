"""Updates, lifts and recorders for the tests of the operator's correspondences."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fleetpose.pose_server.correspondences.records import BookState, Change, JournalError
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import OperatorUpdate, ViewName

EPOCH = "0123456789ab"
SESSION = "aaaaaaaaaaaa"
OTHER_SESSION = "bbbbbbbbbbbb"


def view(robot: str, seq: int = 1) -> ViewName:
    return ViewName(robot=robot, epoch=EPOCH, seq=seq)


def add(n: int, u: float = 100.0, i: str = "r1", j: str = "r2", **more: Any) -> OperatorUpdate:
    return update("add", n, u, i, j, **more)


def update(
    action: str, n: int, u: float = 100.0, i: str = "r1", j: str = "r2", **more: Any
) -> OperatorUpdate:
    fields = {
        "operator": "ann",
        "session": SESSION,
        "base_revision": 0,
        "view_i": view(i),
        "view_j": view(j),
        "pixel_i": np.array([u, 50.0]),
        "pixel_j": np.array([u + 20.0, 60.0]),
    }
    return OperatorUpdate.model_validate(
        {**fields, **more, "action": action, "n": n, "i": i, "j": j}
    )


@dataclass(frozen=True)
class Point:
    p: np.ndarray
    C: np.ndarray


class NoDepthError(FleetPoseError):
    pass


def lift(name: ViewName, pixel: np.ndarray) -> Point:
    """Depth 2 m everywhere but beyond column 600, which lies outside the image."""
    if pixel[0] > 600:
        raise NoDepthError("no depth here, nearest usable point is 12 px away")
    p = np.array([pixel[0] / 100, pixel[1] / 100, 2.0 + name.seq])
    return Point(p, np.diag([1e-4, 1e-4, 1e-2]) * (1 + name.seq))


def keeps(name: ViewName) -> bool:
    return name.seq < 100


class DepthHistory:
    """A recorder that can be told to fail."""

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self.full = False

    def load(self) -> BookState:
        return BookState()

    def record(self, change: Change) -> None:
        if self.full:
            raise JournalError("disk full")
        self.changes.append(change)


def apply(book: CorrespondenceStore, *updates: OperatorUpdate) -> list:
    return [outcome for one in updates for outcome in book.apply(one, keeps, lift)]


def content(book: CorrespondenceStore) -> dict:
    """All that a book holds, comparable."""
    return {
        "messages": [_message(book, pair) for pair in book.pairs()],
        "points": [
            (
                kept.item.id,
                kept.p_i.tolist(),
                kept.C_i.tolist(),
                kept.p_j.tolist(),
                kept.C_j.tolist(),
            )
            for kept in sorted(book.all(), key=lambda kept: kept.item.id)
        ],
    }


def _message(book: CorrespondenceStore, pair: tuple[str, str]) -> tuple:
    message = book.message(*pair, EPOCH)
    items = [
        (k.id, k.operator, str(k.view_i), str(k.view_j), *k.pixel_i, *k.pixel_j, k.revision)
        for k in sorted(message.items, key=lambda k: k.id)
    ]
    return (message.i, message.j, message.revision, items)
