"""The operator's session: what is known and what the operator does.

No screen, no network, and no clock but the one given. Any thread may feed it and any thread may
command it.
"""

import time
from collections.abc import Callable
from typing import ClassVar, TypeVar

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.fleet_model import FleetModel
from fleetpose.hmi_client.model.matrix import default_threshold_m
from fleetpose.hmi_client.model.records import Deed, HalfPick, Pair, Picture, PixelUV
from fleetpose.hmi_client.network.outbox import Ticket
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol.keys import checked_name, ordered_pair
from fleetpose.protocol.messages import Denial, OperatorUpdate, Selection, ViewName

T = TypeVar("T")


class OperatorSession(FleetModel):
    """State and commands of one operator.

    Args:
        operator: the operator's name, a chunk of keys.
        session: epoch of this life of the client; random if none is given.
        clock: monotonic seconds.
        threshold_m: errors above it are shown as a hyphen; default: a share of the scene's depth.
        kept: where updates are kept on disk until they are receipted; what another client of the
            operator left there is sent.

    Attributes:
        acts: whether what the operator does goes out.
    """

    acts: ClassVar[bool] = True

    def __init__(
        self,
        operator: str,
        session: str | None = None,
        clock: Callable[[], float] = time.monotonic,
        threshold_m: float | None = None,
        kept: UpdateLog | None = None,
    ) -> None:
        super().__init__(checked_name(operator), session, clock, kept)
        self.operator = operator
        self._threshold_m = threshold_m
        self.half: HalfPick | None = None
        self._selected_s = clock()

    @property
    def threshold_m(self) -> float:
        """Errors above it are hidden: what the operator said, else what the scene's depth says."""
        if self._threshold_m is not None:
            return self._threshold_m
        return default_threshold_m(None if self.fleet is None else self.fleet.depth_m)

    @property
    def seconds_selected(self) -> float:
        """How long the present pair has been selected."""
        return self.clock() - self._selected_s

    @property
    def denied(self) -> tuple[Denial, ...]:
        """What routers deny to this operator of his own, as the server told last."""
        status, own = self.status, f"operator/{self.operator}"
        denied = () if status is None else status.denied
        return tuple(d for d in denied if d.who.partition("#")[0] == own and f"/{own}/" in d.key)

    # ---- what to look at -------------------------------------------------------------------------

    def select(self, a: str, b: str) -> None:
        """Selects two robots in either order; a half pick of another pair is dropped."""
        if a == b:
            raise OperatorError(f"'{a}' and '{b}' are one robot; a pair needs two")
        for name in (a, b):
            self.robot(name)
        with self._changed:
            pair = ordered_pair(a, b)
            if pair == self.pair:
                return
            self.pair, self.half = pair, None
            self._holding = None
            self._selected_s = self.clock()
            self._unreadable.clear()
            self._gallery.show(pair, self._selected_s)
            self._bump("selection", "pictures", "correspondences", "alignment")

    def next_question(self, step: int = 1) -> bool:
        """Selects the next question of the ranking (-1: the previous); false if none is asked."""
        questions = self.fleet.questions if self.fleet else ()
        if not questions:
            return False
        pairs = [(q.i, q.j) for q in questions]
        at = pairs.index(self.pair) + step if self.pair in pairs else 0
        self.select(*pairs[at % len(pairs)])
        return True

    def set_threshold(self, threshold_m: float) -> None:
        """Errors above it are hidden behind a hyphen; metres, above 0. From then on it no longer
        follows the scene's depth.
        """
        with self._changed:
            self._threshold_m = min(max(threshold_m, 1e-4), 1e4)
            self._bump("settings")

    def toggle_freeze(self) -> None:
        """Holds both pictures until called again, also over several picks.

        Where the server does not keep a frozen view, it lets go at once, with a half pick in it.
        """
        with self._changed:
            gallery = self._gallery
            self._holding = None
            if gallery.lost:
                gallery.held, self.half = False, None
                gallery.thaw()
            else:
                gallery.held = not gallery.held
                if gallery.held:
                    gallery.freeze(self.clock(), without_server=self.silent)
                elif self.half is None:
                    gallery.thaw()
            self._bump("selection", "pictures")

    def hold(self, view_i: ViewName, view_j: ViewName) -> bool:
        """Shows certain views of the selected pair and holds them: at once, or as soon as their
        pictures have been fetched; whether at once.
        """
        with self._changed:
            if (view_i.robot, view_j.robot) != self.pair:
                raise OperatorError(f"{view_i} and {view_j} are not of the selected pair")
            self.half, self._holding = None, (view_i, view_j)
            self._hold_when_there()
            self._bump("selection", "pictures")
            return self._holding is None

    def hold_still(self, seen: Picture | None = None) -> None:
        """Holds both pictures until the next pick is complete or cancelled.

        Args:
            seen: the picture that the operator has before the eyes; default: the newest one.
        """
        with self._changed:
            if self.pair is not None and not self.frozen:
                self._gallery.freeze(self.clock(), () if seen is None else (seen,), self.silent)
                self._bump("selection", "pictures")

    def release(self) -> None:
        """Lets the pictures go on, unless they are held by `toggle_freeze`."""
        with self._changed:
            self._holding = None
            self._release()

    @property
    def fetching(self) -> bool:
        """Whether pictures that are to be held are on their way."""
        return self._holding is not None

    # ---- correspondences -------------------------------------------------------------------------

    def pick(
        self,
        side: int,
        pixel: PixelUV,
        seen: Picture | None = None,
        beside: Picture | None = None,
    ) -> Ticket | None:
        """Picks in the picture of robot i (side 0) or j (side 1).

        The first pick freezes both pictures, since a correspondence belongs to two moments; a
        second one in the same picture moves it; one in the other picture completes it.

        Args:
            side: which picture.
            pixel: where.
            seen: the picture that the operator has before the eyes; default: the newest one.
            beside: the same of the other robot.

        Returns:
            The ticket of the completed correspondence, none after the first half.

        Raises:
            OperatorError: no pair is selected, or there is no picture yet that the server knows.
        """
        with self._changed:
            if self.pair is None:
                raise OperatorError("select two robots first: n, or Enter in the matrix")
            picture = self._pickable(self.pair[side], seen)
            this = HalfPick(side, picture.view, pixel)
            if self.half is None or self.half.side == side:
                before_eyes = (picture,) if beside is None else (picture, beside)
                self._gallery.freeze(self.clock(), before_eyes, self.silent)
                self.half = this
                self._bump("selection", "pictures")
                return None
            other = self.half
            self.half = None
            ticket = self.add(other.view, other.pixel, this.view, this.pixel)
            self._release()
            return ticket

    def _pickable(self, robot: str, seen: Picture | None) -> Picture:
        shown = self.picture(robot)
        if shown is None:
            notice = self.picture_notice(robot)
            raise OperatorError(notice or f"the image of {robot} has not arrived yet")
        picture = seen if seen is not None and seen.view.robot == robot else shown
        if self.frozen and picture.view != shown.view:
            raise OperatorError(f"the image of {robot} has just changed: look again and pick")
        if not self._gallery.is_taken(picture.view):
            where = "no server is heard" if self.silent else "wait a moment"
            raise OperatorError(f"the server has not taken this view yet: {where}")
        return picture

    def cancel(self) -> bool:
        """Drops a half pick, lets the pictures go on and dismisses rejections; whether there was
        anything to cancel.
        """
        with self._changed:
            dismissed = self.pair is not None and self._book.dismiss(self.pair)
            if self.half is None:
                loose = self.frozen and not self._gallery.held
                if loose or self._holding is not None:
                    self.release()
                self._bump("correspondences")
                return dismissed or loose
            self.half = None
            self._release()
            return True

    def add(self, view_a: ViewName, pixel_a: PixelUV, view_b: ViewName, pixel_b: PixelUV) -> Ticket:
        """Adds a correspondence between two views, in either order."""
        return self._do(lambda: self._book.add(view_a, pixel_a, view_b, pixel_b))

    def erase(self, pair: Pair, id: int) -> Ticket:
        """Erases a correspondence of the server's set.

        Raises:
            OperatorError: the set has no such correspondence.
        """
        return self._do(lambda: self._book.erase(pair, id))

    def move(self, pair: Pair, id: int, side: int, pixel: PixelUV) -> Ticket:
        """Moves one pixel of a correspondence, in the image of robot i (side 0) or j.

        Raises:
            OperatorError: the set has no such correspondence, or it is on its way elsewhere.
        """
        return self._do(lambda: self._book.move(pair, id, side, pixel))

    def clear(self, pair: Pair) -> Ticket | None:
        """Erases all correspondences of a pair, own ones on their way included; none if it has
        none.
        """
        return self._do(lambda: self._book.clear(pair))

    def undo(self) -> Deed | None:
        """Takes back the operator's last step and tells which; the first undo drops a half pick;
        none where there is nothing, or the server is still to say what came of it.
        """
        with self._changed:
            if self.half is not None:
                self.cancel()
                return Deed(self.pair, "half a point")
            return self._do(self._book.undo)

    def redo(self) -> Deed | None:
        """Does again what was undone last, and tells which step that was."""
        return self._do(self._book.redo)

    def undoable(self) -> tuple[str | None, str | None]:
        """What undo and redo would do now, in words; none where there is nothing."""
        with self._changed:
            undo, redo = self._book.undoable()
            return ("half a point" if self.half is not None else undo), redo

    # ---- what is to be sent ----------------------------------------------------------------------

    def open_updates(self) -> tuple[OperatorUpdate, ...]:
        """Updates to be offered now, in order, until a receipt covers them."""
        with self._changed:
            return tuple(ticket.update for ticket in self._book.sendable())

    def selection(self) -> Selection:
        """The selected pair and, while frozen, the views that the server has to keep."""
        with self._changed:
            i, j = self.pair or (None, None)
            return Selection(
                operator=self.operator,
                session=self._book.outbox.session,
                i=i,
                j=j,
                view_i=self._gallery.frozen_view(i),
                view_j=self._gallery.frozen_view(j),
            )

    # ---- inside ----------------------------------------------------------------------------------

    def _do(self, deed: Callable[[], T]) -> T:
        with self._changed:
            done = deed()
            self._bump("updates", "correspondences")
            return done

    def _release(self) -> None:
        if not self._gallery.held:
            self._gallery.thaw()
        self._bump("selection", "pictures")
