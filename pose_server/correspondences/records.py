"""What the book keeps and the journal writes down."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import Correspondence, Rejection, ViewName

Floats = npt.NDArray[np.floating]
Pair = tuple[str, str]
Session = tuple[str, str]
"""Operator and the session of the operator's client."""

MAX_REJECTIONS = 100
"""So many rejections of a session are remembered, the newest."""


class JournalError(FleetPoseError):
    """The journal cannot be opened, read or written; nothing of what was attempted has happened."""


class Lifted(Protocol):
    """A clicked point."""

    @property
    def p(self) -> Floats:
        """(3,) metres in the camera frame."""
        ...

    @property
    def C(self) -> Floats:
        """(3, 3) covariance."""
        ...


Lift = Callable[[ViewName, Floats], Lifted]
"""Lifts a pixel (2,) of a kept view; raises a FleetPoseError that says why it cannot."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A correspondence and its points as they were resolved when it arrived.

    Attributes:
        p_i, p_j: (3,) in the camera frames of the two views, metres.
        C_i, C_j: (3, 3) covariances there.
    """

    item: Correspondence
    p_i: Floats
    C_i: Floats
    p_j: Floats
    C_j: Floats


@dataclass(frozen=True, eq=False)
class Change:
    """All that one update does, to be written in one transaction.

    Attributes:
        session, n: whose update, and which.
        rejection: why it is rejected, None if accepted; a rejected one changes nothing else.
        pair: the robots concerned.
        revision: of the pair's set afterwards.
        put: the correspondence that was added or moved.
        erased: ids that are gone.
        next_id: the first id never given to a correspondence.
        views: encoded views that were clicked in.
    """

    session: Session
    n: int
    rejection: str | None
    pair: Pair
    revision: int = 0
    put: Kept | None = None
    erased: tuple[int, ...] = ()
    next_id: int = 0
    views: dict[ViewName, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Progress:
    """How far an operator's session has come: updates up to n are final."""

    n: int = 0
    rejections: tuple[Rejection, ...] = ()

    def after(self, change: Change) -> "Progress":
        """The progress once a change is written."""
        rejections = self.rejections
        if change.rejection is not None:
            rejections = (*rejections, Rejection(n=change.n, reason=change.rejection))
        return Progress(change.n, rejections[-MAX_REJECTIONS:])


@dataclass(frozen=True, eq=False)
class BookState:
    """What a book is made from: all of it comes from the journal."""

    correspondences: tuple[Kept, ...] = ()
    revisions: dict[Pair, int] = field(default_factory=dict)
    sessions: dict[Session, Progress] = field(default_factory=dict)
    next_id: int = 0


class Recorder(Protocol):
    """What a book writes to: the journal, or something that forgets."""

    def load(self) -> BookState:
        """What was recorded so far."""
        ...

    def record(self, change: Change) -> None:
        """Makes a change durable; when it returns, it is.

        Raises:
            JournalError: nothing was written.
        """
        ...
