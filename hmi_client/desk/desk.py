"""What an operator's hands do, whatever shows it: one desk per session, for screens and pages.

A desk holds what is between a session and a face: both cursors in image pixels, the side that is
at work, where a point is expected, suggestions, labels, and what was told to the operator. A face
calls `do` for every command, `follow` at its own rate, and draws what the desk says.
"""

import inspect
import math
import threading
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from fleetpose.hmi_client.assist.pick_assist import Expected, PickAssist
from fleetpose.hmi_client.assist.suggestions import Proposal, Suggestions
from fleetpose.hmi_client.desk.helper import Helper
from fleetpose.hmi_client.desk.hints import MOST, Hints
from fleetpose.hmi_client.desk.keymap import COMMANDS, KeyMap
from fleetpose.hmi_client.errors import OperatorError, PictureError
from fleetpose.hmi_client.model.jpeg import frame_of
from fleetpose.hmi_client.model.matrix import QUANTITIES, Quantity
from fleetpose.hmi_client.model.records import Entry, HalfPick, Pair, Picture, PixelUV
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import ViewName

THRESHOLD_STEP = 1.25
Tone = Literal["ask", "act", "warn", "done", "wait", "gone"]
PageName = Literal["", "help", "events", "why"]
_VIEW_ONLY = {command.id for command in COMMANDS if command.view}
_NOTICES_KEPT = 20


@dataclass(frozen=True)
class Notice:
    """A sentence to be shown for a few seconds, and how it is meant."""

    text: str
    tone: Tone


class Desk:
    """The hands of one operator at one session. Any thread may call it.

    Args:
        session: what is commanded.
        names: how the keys of the commands are called, by the commands' ids; default: the usual.
        where: the site and where its server is, for sentences.

    Attributes:
        side: the image at work, 0 or 1.
        expected: where the other half of a half pick is to be expected, once that is known.
        hints: labels over places of the image at work, while they are shown.
        quantity: what the matrix shows.
        overview, maximised, ellipses, following: how the face arranges itself.
        page: the text that lies over all, and the robot that `why` is about.
        left: whether the operator has left.
    """

    def __init__(
        self, session: OperatorSession, names: Mapping[str, str] | None = None, where: str = ""
    ) -> None:
        self.session = session
        self.names = KeyMap().names() if names is None else names
        self.where = where
        self.guide = PickAssist(session)
        self.suggestions = Suggestions(session, self.guide)
        self.helper = Helper()
        self.side = 0
        self.expected: Expected | None = None
        self.hints: Hints | None = None
        self.quantity: Quantity = "rms"
        self.overview = self.maximised = self.following = self.left = False
        self.ellipses = True
        self.page: PageName = ""
        self.about = ""
        self.done: Counter[str] = Counter()
        self._notices: deque[Notice] = deque(maxlen=_NOTICES_KEPT)
        self._noticed = 0
        self._cursors: dict[int, tuple[str, PixelUV]] = {}
        self._sizes: dict[ViewName, tuple[int, int] | None] = {}
        self._left_at: PixelUV | None = None
        self._pair: Pair | None = None
        self._prepared: tuple[ViewName, ...] = ()
        self._proposed: Proposal | None = None
        self._seen: dict[str, int] = {}
        self._lock = threading.RLock()

    # ---- what there is ---------------------------------------------------------------------------

    def robot(self, side: int) -> str | None:
        """Whose image is on a side."""
        return self.session.pair[side] if self.session.pair else None

    def picture(self, side: int) -> Picture | None:
        """What there is to see on a side."""
        robot = self.robot(side)
        return self.session.picture(robot) if robot else None

    def size(self, side: int) -> tuple[int, int] | None:
        """Width and height of a side's image in full-resolution pixels; none without an image."""
        picture = self.picture(side)
        if picture is None:
            return None
        if picture.view not in self._sizes:
            if len(self._sizes) > 100:
                self._sizes.clear()
            try:
                frame = frame_of(picture.jpeg)
                size = (frame.width * picture.scale, frame.height * picture.scale)
            except PictureError:
                size = None
            self._sizes[picture.view] = size
        return self._sizes[picture.view]

    def cursor(self, side: int) -> PixelUV:
        """Where the cursor of a side is, in full-resolution pixels of the image."""
        robot, place = self._cursors.get(side, ("", (0.0, 0.0)))
        if robot == self.robot(side):
            return place
        width, height = self.size(side) or (0, 0)
        return float(width // 2), float(height // 2)

    def expected_at(self, side: int) -> Expected | None:
        """Where the other half of a pick is expected, if that is on this side."""
        here = self.session.half is not None and self.expected is not None
        return self.expected if here and self.expected.side == side else None  # type: ignore[union-attr]

    def view(self, side: int) -> ViewName | None:
        """The view that is to be seen on a side."""
        picture = self.picture(side)
        return picture.view if picture is not None else None

    def number(self, entry: Entry) -> int:
        """The number of an entry of the list, from 1."""
        return self.session.entries().index(entry) + 1

    def nearest(
        self, side: int, pixel: PixelUV | None = None, reach_px: float = math.inf
    ) -> Entry | None:
        """The point of the server's set whose marker is nearest to a pixel (default: the cursor);
        none if none is within reach.
        """
        at = pixel or self.cursor(side)
        known = [entry for entry in self.session.entries() if entry.id is not None]
        if not known:
            return None
        best = min(known, key=lambda entry: math.dist(pixel_of(entry, side), at))
        return best if math.dist(pixel_of(best, side), at) <= reach_px else None

    def notices_since(self, count: int) -> tuple[list[Notice], int]:
        """Notices after the first `count` ever, as far as they are kept, and how many there were."""
        with self._lock:
            fresh = min(self._noticed - count, len(self._notices))
            return list(self._notices)[len(self._notices) - fresh :], self._noticed

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

    def follow(self) -> None:
        """Takes in what has changed since the last call: call it several times a second.

        Raises:
            Exception: a bug of work that was done beside.
        """
        with self._lock:
            revisions = self.session.revisions()
            depths = revisions.get("depths", 0) != self._seen.get("depths", 0)
            self._seen = revisions
            self._follow_pair()
            self._follow_suggestion()
            self._prepare()
            if depths and self.session.half is not None:
                self._expect(anew=False)
            self.helper.take()

    def settle(self, timeout_s: float = 5.0) -> None:
        """Waits for the work that is done beside, and takes it in."""
        self.follow()
        self.helper.settle(timeout_s)
        self.follow()

    def close(self) -> None:
        """Ends what works beside."""
        self.helper.close()

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

    def _do_pick(
        self, side: object = None, pixel: object = None, seen: Picture | None = None
    ) -> None:
        here = self._turn(side)
        if pixel is not None:
            self._put(here, _pixel(pixel))
        ticket = self.session.pick(here, self.cursor(here), seen)
        self.side = 1 - here if ticket is None else 0
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
        self.session.hold_still(seen)
        width, height = self.size(here) or (640, 480)
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
        here = self._turn(side)
        entry = self._meant(id, here, None, math.inf)
        if entry is None or entry.id is None or self.session.pair is None:
            raise OperatorError("there is no confirmed point here to move")
        shown = seen.view if seen is not None else self.view(here)
        if (entry.pick.view_j if here else entry.pick.view_i) != shown:
            raise OperatorError(
                f"point {self.number(entry)} was clicked in another view: show it first, by the list"
            )
        to = self.cursor(here) if pixel is None else _pixel(pixel)
        if math.dist(to, pixel_of(entry, here)) < 1e-6:
            raise OperatorError("put the cursor where the point belongs first, then move it")
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

    def _meant(self, id: object, side: object, pixel: object, reach: object) -> Entry | None:
        """The entry with an id, else the nearest one."""
        if id is not None:
            return next((e for e in self.session.entries() if e.id == id), None)
        here = self._side(side)
        at = None if pixel is None else _pixel(pixel)
        return self.nearest(here, at, _numbers([reach], 1)[0])

    def _do_undo(self) -> None:
        self.session.undo()

    def _do_redo(self) -> None:
        self.session.redo()

    def _do_cancel(self) -> None:
        self.hints = None
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
        if self.suggestions.current is None:
            raise OperatorError("there is no suggestion on the screen to go back from")
        self.suggestions.skip(-1)

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
        """About a robot; default: the first one of the selected pair."""
        robots = self.session.robots()
        if not robots:
            raise OperatorError("no robot is known yet")
        wanted = robot or self.robot(0) or robots[0]
        self.page, self.about = "why", self.session.robot(str(wanted)).robot

    def _do_quit(self) -> None:
        self.left = True

    # ---- inside ----------------------------------------------------------------------------------

    def tell(self, text: str, tone: Tone) -> None:
        """A sentence for the operator that no command raised."""
        self._notices.append(Notice(text, tone))
        self._noticed += 1

    def _side(self, side: object) -> int:
        if side is None:
            return self.side
        if side not in (0, 1):
            raise OperatorError(f"there are side 0 and side 1, not '{side}'")
        return int(side)  # type: ignore[call-overload]

    def _turn(self, side: object) -> int:
        """Makes a side the one at work."""
        here = self._side(side)
        if here != self.side:
            self.side, self.hints = here, None
        return here

    def _put(self, side: int, pixel: PixelUV) -> None:
        """Puts a cursor on a pixel, inside the image."""
        robot, size = self.robot(side), self.size(side)
        if robot is None:
            return
        u, v = pixel
        if size is not None:
            u, v = min(max(u, 0.0), size[0] - 1.0), min(max(v, 0.0), size[1] - 1.0)
        self._cursors[side] = robot, (u, v)

    def _expect(self, anew: bool = True) -> None:
        """Looks for the other half beside the hand; `anew`, else after more is known."""
        half = self.session.half
        if anew:
            self.expected = None
            self._left_at = None if half is None else self.cursor(1 - half.side)
        if half is None:
            self.helper.forget("expected")
            return
        self.helper.ask("expected", self.guide.expected, lambda e: self._take_expected(half, e))

    def _take_expected(self, half: HalfPick, expected: Expected | None) -> None:
        """The other cursor goes there, unless the hand has moved it since."""
        if self.session.half != half or expected is None:
            return
        untouched = self.cursor(expected.side) == self._left_at
        self.expected = expected
        if untouched:
            self._put(expected.side, expected.pixel)
            self._left_at = here = self.cursor(expected.side)  # inside the image, at any rate
            self.expected = replace(expected, pixel=here)

    def _follow_pair(self) -> None:
        if self.session.pair != self._pair:
            self._pair, self.side, self.expected, self.hints = self.session.pair, 0, None, None
            self.helper.forget("expected")
            self.helper.forget("hints")

    def _follow_suggestion(self) -> None:
        """The cursors show a suggestion, once its pictures are there."""
        self.suggestions.follow()
        proposal = self.suggestions.current
        if proposal != self._proposed:
            self._proposed = proposal
            if proposal is not None:
                self._put(0, proposal.pixel_i)
                self._put(1, proposal.pixel_j)

    def _prepare(self) -> None:
        """What pictures that are held look like is needed after the first half: found before."""
        views = self.session.frozen_views()
        if len(views) == 2 and views != self._prepared:
            self._prepared = views
            self.helper.ask("looks", self.guide.prepare, lambda _: None)


def pixel_of(entry: Entry, side: int) -> PixelUV:
    """Where an entry is in the image of robot i (side 0) or j."""
    return entry.pick.pixel_j if side else entry.pick.pixel_i


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
