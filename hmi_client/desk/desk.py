"""What an operator's hands do, whatever shows it: one desk per session, for screens and pages.

A face calls `do` for every command and `follow` at its own rate, and draws what the desk says.
"""

import inspect
import math
from typing import get_args

from fleetpose.hmi_client.desk.hints import MOST, Hints
from fleetpose.hmi_client.desk.keymap import COMMANDS
from fleetpose.hmi_client.desk.state import DeskState, pixel_of
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.matrix import QUANTITIES, Quantity
from fleetpose.hmi_client.model.records import Deed, Entry, Picture, PixelUV

THRESHOLD_STEP = 1.25
_VIEW_ONLY = {command.id for command in COMMANDS if command.view}


class Desk(DeskState):
    """The hands of one operator at one session. Any thread may call it."""

    # ---- what is done ----------------------------------------------------------------------------

    def do(self, command: str, **args: object) -> None:
        """Carries a command out, by its id in `keymap.COMMANDS`; `cursor` is one as well.

        Args:
            command: the id. Those that only change how a face shows things do nothing here.
            args: of the command; what is left out is what the cursors and the active side say.

        Raises:
            OperatorError: it cannot be done; the sentence says why.
        """
        if command in _VIEW_ONLY:
            return
        deed = getattr(self, f"_do_{command.replace('-', '_')}", None)
        if deed is None:
            raise OperatorError(f"there is no command '{command}'")
        try:
            inspect.signature(deed).bind(**args)
        except TypeError as error:
            raise OperatorError(f"'{command}': {error}") from error
        with self._lock:
            self._follow_pair()
            deed(**args)
            self._follow_suggestion()

    # ---- questions and pairs ---------------------------------------------------------------------

    def _do_next(self) -> None:
        self._question(1)

    def _do_previous(self) -> None:
        self._question(-1)

    def _question(self, step: int) -> None:
        if not self.session.next_question(step):
            raise OperatorError("the server asks nothing at present")
        self.overview = False
        self._follow_pair()

    def _do_select(self, a: object = None, b: object = None) -> None:
        if not isinstance(a, str) or not isinstance(b, str):
            raise OperatorError("say which two robots: a cell of the matrix")
        self.session.select(a, b)
        self.overview = False
        self._follow_pair()

    # ---- hands -----------------------------------------------------------------------------------

    def _do_cursor(self, side: object, pixel: object) -> None:
        self._put(self._turn(side), _pixel(pixel))
        self.hints = None

    def _do_pick(
        self,
        side: object = None,
        pixel: object = None,
        seen: Picture | None = None,
        beside: Picture | None = None,
    ) -> None:
        here = self._turn(side)
        if pixel is not None:
            self._put(here, _pixel(pixel))
        ticket = self.session.pick(here, self.cursor(here), seen, beside)
        self.side, self.hints = 1 - here if ticket is None else 0, None
        self.done["picked"] += ticket is not None
        self._expect()

    def _do_snap(
        self, side: object = None, pixel: object = None, seen: Picture | None = None
    ) -> None:
        here = self._turn(side)
        if pixel is not None:
            self._put(here, _pixel(pixel))
        self.session.hold_still(seen)
        self._put(here, self.guide.snap(here, self.cursor(here)))

    def _do_go(
        self,
        side: object = None,
        apart: object = None,
        within: object = None,
        seen: Picture | None = None,
    ) -> None:
        """Labels over places worth a pick.

        Args:
            side: the image.
            apart: how far from each other, px across and down.
            within: the part of the image that is in sight: left, top, right, bottom, px.
            seen: the picture that the operator has before the eyes.
        """
        here = self._turn(side)
        size = self.size(here)
        if size is None:
            raise OperatorError("there is no image yet to put labels on")
        self.session.hold_still(seen)
        width, height = size
        least = (width / 30, height / 20) if apart is None else _pixel(apart)
        left, top, right, bottom = (0, 0, width, height) if within is None else _numbers(within, 4)

        def show(places: list[PixelUV]) -> None:
            shown = [p for p in places if left <= p[0] < right and top <= p[1] < bottom]
            self.hints = Hints.of(shown) if shown and here == self.side else None
            if not shown:
                self.tell("nothing stands out here: use the arrows", "warn")

        self.helper.ask("hints", lambda: self.guide.places(here, *least, MOST), show)

    def type_hint(self, letter: str) -> None:
        """A letter of a label: at the end of one the cursor goes there; another takes all away."""
        with self._lock:
            if self.hints is None:
                return
            typed = self.hints.type(letter) if letter else None
            chosen = typed.chosen if typed is not None else None
            self.hints = None if chosen is not None else typed
            if chosen is not None:
                self._put(self.side, chosen)

    # ---- points ----------------------------------------------------------------------------------

    def _do_erase(
        self,
        id: object = None,
        side: object = None,
        pixel: object = None,
        reach: object = math.inf,
    ) -> None:
        entry = self._meant(id, side, pixel, reach)
        if entry is None or entry.id is None or self.session.pair is None:
            raise OperatorError("there is no confirmed point to erase here")
        self.session.erase(self.session.pair, entry.id)
        self.done["erased"] += 1

    def _do_move(
        self,
        id: object = None,
        side: object = None,
        pixel: object = None,
        seen: Picture | None = None,
    ) -> None:
        """To a pixel, else to the cursor; if that is on the point, to where the others put it."""
        here = self._turn(side)
        entry = self._meant(id, here, None, math.inf)
        if entry is None or entry.id is None or self.session.pair is None:
            raise OperatorError("there is no confirmed point here to move")
        shown = seen.view if seen is not None else self.view(here)
        if (entry.pick.view_j if here else entry.pick.view_i) != shown:
            number = self.number(entry)
            raise OperatorError(f"point {number} was clicked in another view: show that first")
        to = self.cursor(here) if pixel is None else _pixel(pixel)
        if math.dist(to, pixel_of(entry, here)) < 0.5:
            wrong = self.wrong()
            if wrong is None or wrong.id != entry.id or wrong.fits is None:
                raise OperatorError("put the cursor where the point belongs first, then move it")
            to = self._inside(here, wrong.fits)
        self.session.move(self.session.pair, entry.id, here, to)
        self.done["moved"] += 1

    def _do_show(self, id: object = None, number: object = None) -> None:
        """Shows the views that an entry was clicked in, the cursors at its pixels."""
        entries = self.session.entries()
        if id is not None:
            entry = next((e for e in entries if e.id == id), None)
        else:
            at = number if isinstance(number, int) else 0
            entry = entries[at - 1] if 1 <= at <= len(entries) else None
        if entry is None:
            raise OperatorError("there is no such point in the list")
        self.suggestions.end()
        self.session.hold(entry.pick.view_i, entry.pick.view_j)
        self._put(0, entry.pick.pixel_i)
        self._put(1, entry.pick.pixel_j)

    def _do_look(self) -> None:
        """Shows the point that does not fit."""
        wrong = self.wrong()
        if wrong is None:
            raise OperatorError("no point contradicts the others")
        self._do_show(wrong.id)

    def _meant(self, id: object, side: object, pixel: object, reach: object) -> Entry | None:
        """The entry with an id, else the nearest one.

        Raises:
            OperatorError: the id is that of no entry any more.
        """
        if id is not None:
            named = next((e for e in self.session.entries() if e.id == id), None)
            if named is None:
                raise OperatorError("this point is not there: somebody has erased it meanwhile")
            return named
        here = self._side(side)
        at = None if pixel is None else _pixel(pixel)
        return self.nearest(here, at, _numbers([reach], 1)[0])

    def _do_undo(self) -> None:
        self._told(self.session.undo(), "took back", "nothing can be taken back")

    def _do_redo(self) -> None:
        self._told(self.session.redo(), "did again", "nothing can be done again")

    def _told(self, deed: Deed | None, what: str, nothing: str) -> None:
        """Says which deed that was, and shows its pair."""
        if deed is None:
            raise OperatorError(f"{nothing} now")
        self.done[what] += 1
        self.tell(f"{what}: {deed.text}", "done")
        if deed.pair is not None and set(deed.pair) <= set(self.session.robots()):
            self.session.select(*deed.pair)
            self._follow_pair()

    def _do_cancel(self) -> None:
        self.hints = None
        self.helper.forget("hints")
        self.suggestions.end()
        self.session.cancel()

    def _do_freeze(self) -> None:
        self.session.toggle_freeze()

    # ---- suggestions -----------------------------------------------------------------------------

    def _do_accept(self) -> None:
        """Accepts the suggestion that is shown, as the cursors correct it; the first begins."""
        if self.suggestions.current is not None:
            self.suggestions.accept(self.cursor(0), self.cursor(1))
            self.done["picked"] += 1
        elif not self.suggestions.waiting:
            self.suggestions.begin()

    def _do_skip(self) -> None:
        if self.suggestions.current is not None:
            self.suggestions.skip()
        else:
            self._do_accept()

    def _do_back(self) -> None:
        self.suggestions.back()

    # ---- how it is shown -------------------------------------------------------------------------

    def _do_quantity(self, value: object = None) -> None:
        if value is None:
            value = QUANTITIES[(QUANTITIES.index(self.quantity) + 1) % len(QUANTITIES)]
        if value not in get_args(Quantity):
            raise OperatorError(f"the matrix shows {', '.join(QUANTITIES)}; not '{value}'")
        self.quantity = value  # type: ignore[assignment]

    def _do_hide_more(self) -> None:
        self.session.set_threshold(self.session.threshold_m / THRESHOLD_STEP)

    def _do_show_more(self) -> None:
        self.session.set_threshold(self.session.threshold_m * THRESHOLD_STEP)

    def _do_maximise(self) -> None:
        self.maximised, self.overview = not self.maximised, False

    def _do_overview(self) -> None:
        self.overview, self.maximised = not self.overview, False

    def _do_ellipses(self) -> None:
        self.ellipses = not self.ellipses

    def _do_follow(self) -> None:
        self.following = not self.following

    def _do_help(self) -> None:
        self.page = "help"

    def _do_events(self) -> None:
        self.page = "events"

    def _do_why(self, robot: object = None) -> None:
        """About a robot; default: one of the selected pair, that is not located if there is one."""
        robots = self.session.robots()
        if not robots:
            raise OperatorError("no robot is known yet")
        wanted = robot or self.in_question() or robots[0]
        self.page, self.about = "why", self.session.robot(str(wanted)).robot

    def _do_quit(self) -> None:
        self.left = True

    # ---- inside ----------------------------------------------------------------------------------

    def _side(self, side: object) -> int:
        if side is None:
            return self.side
        if side not in (0, 1):
            raise OperatorError(f"there are side 0 and side 1, not '{side}'")
        return int(side)  # type: ignore[call-overload]

    def _turn(self, side: object) -> int:
        """Makes a side the one at work."""
        here = self._side(side)
        self.turn(here)
        return here


def _pixel(told: object) -> PixelUV:
    u, v = _numbers(told, 2)
    return u, v


def _numbers(told: object, count: int) -> list[float]:
    try:
        numbers = [float(x) for x in told]  # type: ignore[attr-defined]
    except (TypeError, ValueError) as error:
        raise OperatorError(f"{count} numbers are needed, not '{told}'") from error
    if len(numbers) != count or any(math.isnan(x) for x in numbers):
        raise OperatorError(f"{count} numbers are needed, not '{told}'")
    return numbers
