"""The authoritative set of the operator's correspondences.

Updates are numbered per operator and session and take effect in that order, each exactly once: one
that was applied is ignored, one that comes early waits. Each is finally accepted or rejected. What
an update does is worked out first, then made durable by the recorder, and only then adopted.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.correspondences.records import (
    Change,
    JournalError,
    Kept,
    Lift,
    Pair,
    Progress,
    Recorder,
    Session,
)
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import (
    Correspondence,
    CorrespondenceStatus,
    OperatorUpdate,
    PairCorrespondences,
    Receipts,
    ViewName,
)

__all__ = ["CorrespondenceStore", "Kept", "Outcome"]

Floats = npt.NDArray[np.floating]
Judgement = tuple[CorrespondenceStatus, float | None, float | None]
"""Status, residual in metres, residual in pixels."""

MAX_AHEAD = 1000
"""An update this far ahead of the next one is dropped; its operator repeats it."""
MAX_WAITING_SESSIONS = 64
MAX_PER_PAIR = 500
DUPLICATE_PX = 1.0
_SAME_RESIDUAL = 0.02  # relative change of a residual that nobody needs to be told


class _RejectedError(FleetPoseError):
    """An update that is finally rejected, and why."""


@dataclass(frozen=True)
class Outcome:
    """What became of one update; final and recorded.

    Attributes:
        accepted: whether it took effect; if not, `reason` says why.
        pair: the robots whose set it concerns.
        views: that were clicked in.
    """

    operator: str
    session: str
    n: int
    action: Literal["add", "move", "erase", "clear"]
    accepted: bool
    reason: str
    pair: Pair
    views: tuple[ViewName, ...] = ()


class CorrespondenceStore:
    """All live correspondences; made from what the recorder holds.

    Raises:
        JournalError: the recorder cannot be read.
    """

    def __init__(self, recorder: Recorder) -> None:
        state = recorder.load()
        self._recorder = recorder
        self._revisions = dict(state.revisions)
        self._sessions = dict(state.sessions)
        self._next_id = state.next_id
        self._sets: dict[Pair, dict[int, Kept]] = {pair: {} for pair in self._revisions}
        for kept in state.correspondences:
            pair = (kept.item.view_i.robot, kept.item.view_j.robot)
            self._sets.setdefault(pair, {})[kept.item.id] = kept
        self._waiting: dict[Session, dict[int, OperatorUpdate]] = {}

    def apply(
        self,
        update: OperatorUpdate,
        keeps: Callable[[ViewName], bool],
        lift: Lift,
        encoded: Callable[[ViewName], bytes] | None = None,
        knows: Callable[[Pair], bool] = lambda pair: True,
    ) -> list[Outcome]:
        """Takes an update and applies it and all that waited for it, as far as there is no gap.

        Args:
            update: the update; applied already: ignored.
            keeps: whether a view can be clicked in.
            lift: lifts a pixel to a 3D point, or raises a FleetPoseError with the reason.
            encoded: the bytes of a kept view, to be recorded along with the click.
            knows: whether two robots are any of the site's; else nothing is kept of them.

        Returns:
            What became final, in order; empty for a repeated or an early update.

        Raises:
            JournalError: it could not be recorded; nothing changed, the update may be repeated.
        """
        session = (update.operator, update.session)
        self._wait(session, update)
        outcomes: list[Outcome] = []
        while (following := self._following(session)) is not None:
            change = self._worked_out(following, keeps, lift, encoded, knows)
            try:
                self._recorder.record(change)
            except JournalError:
                if outcomes:  # these are final and must be told; the rest goes on waiting
                    return outcomes
                raise
            self._adopt(change)
            outcomes.append(_outcome(following, change))
        return outcomes

    def of(self, a: str, b: str) -> list[Kept]:
        """The correspondences of a pair, oldest first."""
        return list(self._sets.get(ordered_pair(a, b), {}).values())

    def all(self) -> list[Kept]:
        """All correspondences."""
        return [kept for members in self._sets.values() for kept in members.values()]

    def has(self, a: str, b: str) -> bool:
        """Whether a pair has or had correspondences."""
        return ordered_pair(a, b) in self._sets

    def pairs(self) -> list[Pair]:
        """The pairs that have or had correspondences."""
        return sorted(self._sets)

    def views(self) -> set[ViewName]:
        """The views that correspondences are tied to."""
        return {view for kept in self.all() for view in (kept.item.view_i, kept.item.view_j)}

    def message(self, a: str, b: str, server_epoch: str) -> PairCorrespondences:
        """The set of a pair as it is published."""
        i, j = ordered_pair(a, b)
        return PairCorrespondences(
            i=i,
            j=j,
            revision=self._revisions.get((i, j), 0),
            items=tuple(kept.item for kept in self.of(i, j)),
            server_epoch=server_epoch,
        )

    def receipts(self, update: OperatorUpdate, server_epoch: str) -> Receipts:
        """How far the session of an update has come, as it is published."""
        progress = self._sessions.get((update.operator, update.session), Progress())
        return Receipts(
            operator=update.operator,
            session=update.session,
            n=progress.n,
            rejections=progress.rejections,
            server_epoch=server_epoch,
        )

    def set_status(self, pair: Pair, judgements: dict[int, Judgement]) -> bool:
        """Notes how correspondences fit the solution; this is no revision and is not recorded.

        Args:
            pair: the robots, in order.
            judgements: by id; unknown ids (erased meanwhile) are skipped.

        Returns:
            Whether anything changed that is worth publishing.
        """
        members = self._sets.get(pair, {})
        changed = False
        for number, (status, residual_m, residual_px) in judgements.items():
            kept = members.get(number)
            if kept is None or _alike(kept.item, status, residual_m, residual_px):
                continue
            judged = {"status": status, "residual_m": residual_m, "residual_px": residual_px}
            members[number] = replace(kept, item=kept.item.model_copy(update=judged))
            changed = True
        return changed

    def _wait(self, session: Session, update: OperatorUpdate) -> None:
        done = self._sessions.get(session, Progress()).n
        if not done < update.n <= done + MAX_AHEAD:
            return
        if session not in self._waiting and len(self._waiting) >= MAX_WAITING_SESSIONS:
            del self._waiting[next(iter(self._waiting))]
        self._waiting.setdefault(session, {}).setdefault(update.n, update)

    def _following(self, session: Session) -> OperatorUpdate | None:
        """The next update of a session, if it is here. It waits on until it is adopted."""
        done = self._sessions.get(session, Progress()).n
        return self._waiting.get(session, {}).get(done + 1)

    def _worked_out(
        self,
        update: OperatorUpdate,
        keeps: Callable[[ViewName], bool],
        lift: Lift,
        encoded: Callable[[ViewName], bytes] | None,
        knows: Callable[[Pair], bool],
    ) -> Change:
        """What an update does; nothing is changed yet."""
        session, pair = (update.operator, update.session), (update.i, update.j)
        try:
            if update.i >= update.j:
                raise _RejectedError(f"robots {update.i}, {update.j} must be two, in order of name")
            if pair not in self._sets and not knows(pair):
                raise _RejectedError(f"robots {update.i} and {update.j} are not both known here")
            put, erased = None, ()
            if update.action in ("add", "move"):
                put = self._placed(update, keeps, lift)
            elif update.action == "erase":
                erased = (self._current(update).item.id,)
            else:
                erased = self._cleared(update)
        except _RejectedError as error:
            return Change(session, update.n, str(error)[:2000], pair)
        clicked = () if put is None else (put.item.view_i, put.item.view_j)
        return Change(
            session,
            update.n,
            None,
            pair,
            self._revisions.get(pair, 0) + 1,
            put,
            erased,
            self._next_id + (update.action == "add"),
            {} if encoded is None else {view: encoded(view) for view in clicked},
        )

    def _placed(
        self, update: OperatorUpdate, keeps: Callable[[ViewName], bool], lift: Lift
    ) -> Kept:
        before = self._current(update) if update.action == "move" else None
        view_i, view_j, pixel_i, pixel_j = _places(update)
        item = Correspondence(
            id=self._next_id if before is None else before.item.id,
            operator=update.operator,
            view_i=view_i,
            view_j=view_j,
            pixel_i=pixel_i,
            pixel_j=pixel_j,
            revision=0 if before is None else before.item.revision + 1,
        )
        self._check_new(item, (update.i, update.j))
        for view in (view_i, view_j):
            if not keeps(view):
                raise _RejectedError(f"view {view} is not kept any more: pick in a newer image")
        at_i, at_j = _lifted(lift, view_i, pixel_i), _lifted(lift, view_j, pixel_j)
        return Kept(item, *at_i, *at_j)

    def _check_new(self, item: Correspondence, pair: Pair) -> None:
        members = self._sets.get(pair, {})
        if item.id not in members and len(members) >= MAX_PER_PAIR:
            raise _RejectedError(
                f"{len(members)} correspondences are the most a pair can have: erase some"
            )
        for other in members.values():
            if other.item.id != item.id and _same_place(other.item, item):
                raise _RejectedError(
                    f"duplicate of correspondence {other.item.id}: both pixels within "
                    f"{DUPLICATE_PX:g} px"
                )

    def _current(self, update: OperatorUpdate) -> Kept:
        """The correspondence that is moved or erased, as its operator saw it."""
        number = update.correspondence
        kept = self._sets.get((update.i, update.j), {}).get(-1 if number is None else number)
        if kept is None:
            raise _RejectedError(f"correspondence {number} of {update.i}, {update.j} is not there")
        if kept.item.revision != update.base_revision:
            raise _RejectedError(
                f"correspondence {number} was changed meanwhile: it is at revision "
                f"{kept.item.revision}, this was made at {update.base_revision}"
            )
        return kept

    def _cleared(self, update: OperatorUpdate) -> tuple[int, ...]:
        revision = self._revisions.get((update.i, update.j), 0)
        if revision != update.base_revision:
            raise _RejectedError(
                f"the set of {update.i}, {update.j} was changed meanwhile: it is at revision "
                f"{revision}, this was made at {update.base_revision}"
            )
        return tuple(self._sets.get((update.i, update.j), {}))

    def _adopt(self, change: Change) -> None:
        """Makes a recorded change ours."""
        progress = self._sessions.get(change.session, Progress())
        self._sessions[change.session] = progress.after(change)
        waiting = self._waiting[change.session]
        del waiting[change.n]
        if not waiting:
            del self._waiting[change.session]
        if change.rejection is not None:
            return
        members = self._sets.setdefault(change.pair, {})
        for number in change.erased:
            del members[number]
        if change.put is not None:
            members[change.put.item.id] = change.put
        self._revisions[change.pair] = change.revision
        self._next_id = change.next_id


def _outcome(update: OperatorUpdate, change: Change) -> Outcome:
    reason = change.rejection or ""
    accepted = change.rejection is None
    return Outcome(
        update.operator,
        update.session,
        update.n,
        update.action,
        accepted,
        reason,
        change.pair,
        tuple(change.views),
    )


def _places(update: OperatorUpdate) -> tuple[ViewName, ViewName, Floats, Floats]:
    view_i, view_j, pixel_i, pixel_j = update.view_i, update.view_j, update.pixel_i, update.pixel_j
    if view_i is None or view_j is None or pixel_i is None or pixel_j is None:
        raise _RejectedError(f"'{update.action}' needs both views and both pixels")
    if (view_i.robot, view_j.robot) != (update.i, update.j):
        raise _RejectedError(
            f"views {view_i} and {view_j} are not of the robots {update.i} and {update.j}"
        )
    for robot, pixel in ((update.i, pixel_i), (update.j, pixel_j)):
        if not np.isfinite(pixel).all():
            raise _RejectedError(f"{robot}: pixel ({pixel[0]}, {pixel[1]}) is no place in an image")
    return view_i, view_j, pixel_i, pixel_j


def _lifted(lift: Lift, view: ViewName, pixel: Floats) -> tuple[Floats, Floats]:
    try:
        point = lift(view, pixel)
    except FleetPoseError as error:
        raise _RejectedError(f"{view.robot}: {error}") from error
    if not (np.isfinite(point.p).all() and np.isfinite(point.C).all()):
        raise _RejectedError(f"{view.robot}: the point under the pixel is not finite")
    return point.p, point.C


def _same_place(a: Correspondence, b: Correspondence) -> bool:
    """Whether two correspondences are the same to a pixel; the cheap comparisons come first."""
    return (
        abs(a.pixel_i[0] - b.pixel_i[0]) < DUPLICATE_PX
        and bool(np.linalg.norm(a.pixel_i - b.pixel_i) < DUPLICATE_PX)
        and bool(np.linalg.norm(a.pixel_j - b.pixel_j) < DUPLICATE_PX)
        and (a.view_i, a.view_j) == (b.view_i, b.view_j)
    )


def _alike(
    item: Correspondence,
    status: CorrespondenceStatus,
    residual_m: float | None,
    residual_px: float | None,
) -> bool:
    """Whether a judgement says nothing new."""
    return item.status == status and all(
        was is now if was is None or now is None else abs(was - now) <= _SAME_RESIDUAL * was
        for was, now in ((item.residual_m, residual_m), (item.residual_px, residual_px))
    )
