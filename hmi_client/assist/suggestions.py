"""The server's suggestions for a question, one after the other: nothing vouches for them, so each
is looked at, corrected, and accepted or skipped.
"""

from dataclasses import dataclass

from fleetpose.hmi_client.assist.pick_assist import PickAssist
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.records import PixelUV
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.outbox import Ticket
from fleetpose.protocol.messages import Question, Suggestion, ViewName


@dataclass(frozen=True)
class Proposal:
    """Two pixels that may show the same point, the n-th of so many."""

    pixel_i: PixelUV
    pixel_j: PixelUV
    number: int
    of: int


class Suggestions:
    """Goes through the suggestions of one question, in the views that it is about."""

    def __init__(self, session: OperatorSession, guide: PickAssist) -> None:
        self._session = session
        self._guide = guide
        self._views: tuple[ViewName, ViewName] | None = None
        self._all: tuple[Suggestion, ...] = ()
        self._at = 0

    @property
    def current(self) -> Proposal | None:
        """What is to be looked at; none outside of this mode, or while its pictures are fetched."""
        if self._views is None or self._session.frozen_views() != self._views:
            return None
        suggestion = self._all[self._at]
        u_i, v_i = (float(x) for x in suggestion.pixel_i)
        u_j, v_j = (float(x) for x in suggestion.pixel_j)
        return Proposal((u_i, v_i), (u_j, v_j), self._at + 1, len(self._all))

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
        fresh = [s for s in question.suggestions if not self._clicked(s)]
        if not fresh:
            what = "any more" if question.suggestions else "yet"
            raise OperatorError(f"nothing is suggested for this pair {what}: pick points yourself")
        self._views, self._all, self._at = (question.view_i, question.view_j), tuple(fresh), 0
        self._session.hold(*self._views)

    def accept(self, pixel_i: PixelUV, pixel_j: PixelUV) -> Ticket:
        """Makes the present suggestion, as the operator corrected it, a correspondence, and goes on
        to the next.

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
        self.skip()
        return ticket

    def skip(self, step: int = 1) -> None:
        """Goes to the next suggestion, or to one before; after the last it is over."""
        self._at = max(self._at + step, 0)
        if self._at >= len(self._all):
            self.end()

    def end(self) -> None:
        """Leaves the suggestions; the pictures go on."""
        if self._views is not None:
            self._views, self._all, self._at = None, (), 0
            self._session.release()

    def follow(self) -> None:
        """Ends where the operator has turned to something else."""
        left = self._views is not None and not self._session.fetching
        if left and self._session.frozen_views() != self._views:
            self._views, self._all, self._at = None, (), 0

    # ---- inside ----------------------------------------------------------------------------------

    def _question(self) -> Question:
        pair, question = self._session.pair, self._session.question()
        if pair is None:
            raise OperatorError("select two robots first: n, or Enter in the matrix")
        if question is None or (question.i, question.j) != pair:
            raise OperatorError("nothing is asked about this pair, so nothing is suggested")
        return question

    def _clicked(self, suggestion: Suggestion) -> bool:
        u_i, v_i = (float(x) for x in suggestion.pixel_i)
        u_j, v_j = (float(x) for x in suggestion.pixel_j)
        return self._guide.clicked_already((u_i, v_i), (u_j, v_j))
