"""The server's suggestions for a question, one after the other: nothing vouches for them, so each
is looked at, corrected, and accepted or skipped. Points that were accepted say what is left: what
their distances contradict is dropped, and what lies far from them comes first.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from fleetpose.hmi_client.assist.clicked_points import ClickedPoints, is_live
from fleetpose.hmi_client.assist.pick_assist import PickAssist
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.records import Pair, Pick, PixelUV
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.outbox import Ticket
from fleetpose.protocol.messages import Question, Suggestion, ViewName

_FAR_PX = 120.0  # farther than that from all others is no better


@dataclass(frozen=True)
class Proposal:
    """Two pixels that may show the same point, the n-th of so many."""

    pixel_i: PixelUV
    pixel_j: PixelUV
    number: int
    of: int


class Suggestions:
    """Goes through the suggestions of one question, in the views that it is about.

    Attributes:
        dropped: how many of them accepted points contradict.
        refused: the pair whose suggestions were all skipped, until they are shown again.
    """

    def __init__(self, session: OperatorSession, guide: PickAssist, points: ClickedPoints) -> None:
        self._session = session
        self._guide = guide
        self._points = points
        self._views: tuple[ViewName, ViewName] | None = None
        self._all: tuple[Pick, ...] = ()
        self._at = 0
        self._accepted = False
        self.dropped = 0
        self.refused: Pair | None = None

    @property
    def current(self) -> Proposal | None:
        """What is to be looked at; none outside of this mode, or while its pictures are fetched."""
        if self._views is None or self._session.frozen_views() != self._views:
            return None
        pick = self._all[self._at]
        return Proposal(pick.pixel_i, pick.pixel_j, self._at + 1, len(self._all))

    @property
    def waiting(self) -> bool:
        """Whether the pictures of the suggestions are being fetched."""
        return self._views is not None and self._session.fetching

    def begin(self) -> None:
        """Shows the first suggestion about the selected pair.

        Raises:
            OperatorError: there is none, or none that has not been clicked already.
        """
        question = self._question()
        picks = (_pick_of(question, suggestion) for suggestion in question.suggestions)
        fresh = self._ranked(pick for pick in picks if not self._clicked(pick))
        if not fresh:
            what = "any more" if question.suggestions else "yet"
            raise OperatorError(f"nothing is suggested for this pair {what}: pick points yourself")
        self._views, self._all, self._at = (question.view_i, question.view_j), fresh, 0
        self._accepted, self.refused = False, None
        self._session.hold(*self._views)

    def accept(self, pixel_i: PixelUV, pixel_j: PixelUV) -> Ticket:
        """Makes the present suggestion, as the operator corrected it, a correspondence, and goes on
        to the next that does not contradict it.

        Raises:
            OperatorError: there is no suggestion on the screen, or its pictures are not kept.
        """
        if self.current is None or self._views is None:
            raise OperatorError("there is no suggestion on the screen")
        for view in self._views:
            if self._session.keeping(view.robot) == "not kept":
                raise OperatorError(f"the server does not keep this view of {view.robot} any more")
        view_i, view_j = self._views
        ticket = self._session.add(view_i, pixel_i, view_j, pixel_j)
        self._accepted = True
        self.skip()
        return ticket

    def skip(self) -> None:
        """Goes to the next suggestion; after the last it is over."""
        done, left = self._all[: self._at + 1], self._all[self._at + 1 :]
        self._all, self._at = done + self._ranked(left), self._at + 1
        if self._at >= len(self._all):
            self.refused = None if self._accepted else self._session.pair
            self.end()

    def back(self) -> None:
        """Goes to the one before that was not accepted.

        Raises:
            OperatorError: there is none.
        """
        before = [k for k in range(self._at) if not self._clicked(self._all[k])]
        if self.current is None or not before:
            raise OperatorError("there is no suggestion before this one")
        self._at = before[-1]

    def end(self) -> None:
        """Leaves the suggestions; the pictures go on."""
        if self._views is not None:
            self._views, self._all, self._at = None, (), 0
            self._session.release()

    def follow(self) -> None:
        """Ends where the operator has turned to something else, and where all has been said: the
        pair is joined and no longer asked about.
        """
        left = self._views is not None and not self._session.fetching
        if left and self._session.frozen_views() != self._views:
            self._views, self._all, self._at = None, (), 0
        if self._views is not None and self._is_answered():
            self.end()

    # ---- inside ----------------------------------------------------------------------------------

    def _is_answered(self) -> bool:
        session = self._session
        answers = session.fleet.answered if session.fleet else ()
        asked = {(q.i, q.j) for q in (session.fleet.questions if session.fleet else ())}
        joined = any((a.i, a.j) == session.pair and a.joined for a in answers)
        return joined and session.pair not in asked

    def _question(self) -> Question:
        pair, question = self._session.pair, self._session.question()
        if pair is None:
            raise OperatorError("select two robots first: n, or Enter in the matrix")
        if question is None or (question.i, question.j) != pair:
            raise OperatorError("nothing is asked about this pair, so nothing is suggested")
        return question

    def _ranked(self, picks: Iterable[Pick]) -> tuple[Pick, ...]:
        """Without those that points clicked so far contradict; far ones first, and of those about
        as far the server's order.
        """
        clicked = [entry.pick for entry in self._session.entries() if is_live(entry)]
        before = list(picks)
        if not clicked:
            return tuple(before)
        left = [p for p in before if not any(self._points.misfit(p, c) for c in clicked)]
        self.dropped += len(before) - len(left)

        def distance(pick: Pick) -> float:
            return min(min(math.dist(pick.pixel_i, c.pixel_i), _FAR_PX) for c in clicked)

        return tuple(sorted(left, key=lambda pick: -round(distance(pick) / 20)))

    def _clicked(self, pick: Pick) -> bool:
        return self._guide.clicked_already(pick.pixel_i, pick.pixel_j)


def _pick_of(question: Question, suggestion: Suggestion) -> Pick:
    u_i, v_i = (float(x) for x in suggestion.pixel_i)
    u_j, v_j = (float(x) for x in suggestion.pixel_j)
    return Pick(question.view_i, question.view_j, (u_i, v_i), (u_j, v_j))
