"""What lies between a session and a face: cursors, the side at work, what is expected where."""

import math
import threading
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from fleetpose.hmi_client.assist.clicked_points import ClickedPoints, Wrong
from fleetpose.hmi_client.assist.pick_assist import Expected, PickAssist
from fleetpose.hmi_client.assist.suggestions import Proposal, Suggestions
from fleetpose.hmi_client.desk.helper import Helper
from fleetpose.hmi_client.desk.hints import Hints
from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.jpeg import frame_of
from fleetpose.hmi_client.model.matrix import Quantity
from fleetpose.hmi_client.model.records import Entry, HalfPick, Pair, Picture, PixelUV
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import ViewName

Tone = Literal["ask", "act", "warn", "done", "wait", "gone"]
PageName = Literal["", "help", "events", "why"]
_NOTICES_KEPT = 20


@dataclass(frozen=True)
class Notice:
    """A sentence to be shown for a few seconds, and how it is meant."""

    text: str
    tone: Tone


class DeskState:
    """What there is on an operator's desk. `follow` keeps it up to date.

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
        done: how often what was done, for the line that is said at the end.
    """

    def __init__(
        self, session: OperatorSession, names: Mapping[str, str] | None = None, where: str = ""
    ) -> None:
        self.session = session
        self.names = KeyMap().names() if names is None else names
        self.where = where
        self.guide = PickAssist(session)
        self.points = ClickedPoints(session)
        self.suggestions = Suggestions(session, self.guide, self.points)
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

    def depth(self, side: int) -> float | None:
        """How far away what is under a cursor is, metres; none where that is not known."""
        view = self.view(side)
        lifted = None if view is None else self.points.at(view, self.cursor(side))
        return None if lifted is None else float(lifted.point[2])

    def wrong(self) -> Wrong | None:
        """The point of the selected pair that the others contradict, told on the side at work;
        `fits` only where that is in the image.
        """
        wrong, size = self.points.wrong(self.session.entries(), self.side), self.size(self.side)
        if wrong is None or wrong.fits is None or size is None:
            return wrong
        inside = all(-0.5 <= x < most - 0.5 for x, most in zip(wrong.fits, size, strict=True))
        return wrong if inside else replace(wrong, fits=None, off_px=None)

    def in_question(self) -> str | None:
        """Of the selected pair the robot that is not located, else the one on the side at work."""
        poses, pair = self.session.poses(), self.session.pair or ()
        lost = [name for name in pair if name not in poses or not poses[name].located]
        return lost[0] if lost else self.robot(self.side)

    def shows(self, id: int) -> bool:
        """Whether a point is seen in the very views that it was clicked in."""
        entry = next((e for e in self.session.entries() if e.id == id), None)
        seen = self.view(0), self.view(1)
        return entry is not None and (entry.pick.view_i, entry.pick.view_j) == seen

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
        """Notices after the first `count`, as far as they are kept, and how many there were."""
        with self._lock:
            fresh = min(self._noticed - count, len(self._notices))
            return list(self._notices)[len(self._notices) - fresh :], self._noticed

    # ---- following the session -------------------------------------------------------------------

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
            self.points.learn()
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

    def turn(self, side: int) -> None:
        """Makes a side the one at work; labels on the other go away."""
        if side != self.side:
            self.side, self.hints = side, None

    def point_at(self, entry: Entry) -> None:
        """Puts both cursors where an entry was clicked."""
        with self._lock:
            self._put(0, entry.pick.pixel_i)
            self._put(1, entry.pick.pixel_j)

    def tell(self, text: str, tone: Tone) -> None:
        """A sentence for the operator that no command raised."""
        self._notices.append(Notice(text, tone))
        self._noticed += 1

    def _put(self, side: int, pixel: PixelUV) -> None:
        """Puts a cursor on a pixel, inside the image."""
        robot = self.robot(side)
        if robot is not None:
            self._cursors[side] = robot, self._inside(side, pixel)

    def _inside(self, side: int, pixel: PixelUV) -> PixelUV:
        size = self.size(side)
        if size is None:
            return pixel
        return min(max(pixel[0], 0.0), size[0] - 1.0), min(max(pixel[1], 0.0), size[1] - 1.0)

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
