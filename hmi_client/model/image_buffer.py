"""The pictures of the selected pair, and holding them still while the operator picks.

A picture is offered once the server has its view: a click in another could not be lifted. While
pictures are held still, the server is asked to keep their views, and says which it does.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from fleetpose.hmi_client.model.records import Pair, Picture
from fleetpose.protocol.messages import ViewName

STALE_S = 10.0  # a picture of an earlier selection is shown again only if it is younger
KEEP_S = 3.0  # after this long the server should have said that it keeps a frozen view
MAX_WAITING = 8
MAX_FETCHED = 4

Keeping = Literal["", "pinned", "not kept"]


@dataclass
class Frozen:
    """A picture that is held still.

    Attributes:
        taken: whether the server has had the view.
        asked_s: since when the server is asked to keep it, or when it last said that it does.
        keeping: what the server says, empty while there is still time for an answer.
        told: whether the operator has been told that it is not kept.
    """

    picture: Picture
    taken: bool
    asked_s: float
    keeping: Keeping = ""
    told: bool = False


class ImageBuffer:
    """Per robot the newest picture that the server has taken, those that wait for that, and the
    frozen one that is shown instead.
    """

    def __init__(self) -> None:
        self.pair: Pair = ("", "")
        self.held = False
        self._taken: dict[str, Picture] = {}
        self._waiting: dict[str, list[Picture]] = {}
        self._fetched: dict[ViewName, Picture] = {}
        self._server: dict[str, ViewName] = {}
        self._frozen: dict[str, Frozen] | None = None

    @property
    def frozen(self) -> bool:
        return self._frozen is not None

    def show(self, pair: Pair, now_s: float) -> None:
        """Turns to a pair; pictures of others and stale ones are dropped, a freeze is released."""
        self.pair, self.held, self._frozen = pair, False, None
        self._taken = {
            robot: picture
            for robot, picture in self._taken.items()
            if robot in pair and now_s - picture.received_s < STALE_S
        }
        self._waiting = {robot: kept for robot, kept in self._waiting.items() if robot in pair}

    # ---- what arrives ----------------------------------------------------------------------------

    def put(self, picture: Picture, now_s: float) -> bool:
        """Takes a picture; whether one that may be shown was added.

        A frozen gallery still shows the first picture of a robot.
        """
        robot = picture.view.robot
        if robot not in self.pair:
            return False
        if self._server_has(picture.view):
            return self._take(picture, now_s)
        waiting = self._waiting.setdefault(robot, [])
        if waiting and waiting[-1].view.epoch != picture.view.epoch:
            waiting.clear()
        if waiting and waiting[-1].view == picture.view:
            return False
        waiting.append(picture)
        if len(waiting) > MAX_WAITING:  # thinned evenly: whatever the server takes next is near
            seqs = [kept.view.seq for kept in waiting]
            inner = range(1, MAX_WAITING)
            del waiting[min(inner, key=lambda k: seqs[k + 1] - seqs[k - 1])]
        return True

    def put_fetched(self, picture: Picture) -> None:
        """Takes the picture of a certain view, to be held."""
        self._fetched.pop(picture.view, None)
        self._fetched[picture.view] = picture
        for view in list(self._fetched)[:-MAX_FETCHED]:
            del self._fetched[view]

    def follow(
        self,
        newest: Mapping[str, ViewName],
        pinned: Container[ViewName],
        now_s: float,
        anew: bool,
    ) -> tuple[bool, list[ViewName]]:
        """Follows the server's state.

        Args:
            newest: the newest view that it has per robot.
            pinned: the views it keeps for its operators.
            now_s: the session's clock.
            anew: another server, or one that was not heard for a while: it is given time again.

        Returns:
            Whether anything changed, and the frozen views that it has turned out not to keep.
        """
        self._server = dict(newest)
        changed = False
        for robot in self.pair:
            waiting = self._waiting.get(robot, [])
            ready = [picture for picture in waiting if self._server_has(picture.view)]
            if ready:
                self._waiting[robot] = [p for p in waiting if p.view.seq > ready[-1].view.seq]
                changed |= self._take(ready[-1], now_s)
        lost = []
        for frozen in (self._frozen or {}).values():
            before = frozen.keeping
            if self._is_lost(frozen, pinned, now_s, anew):
                lost.append(frozen.picture.view)
            changed |= frozen.keeping != before
        return changed, lost

    def discard(self, view: ViewName) -> None:
        """Forgets a picture that turned out to be none."""
        for pictures in (self._taken, self._frozen or {}):
            held = pictures.get(view.robot)
            if held is not None and picture_of(held).view == view:
                del pictures[view.robot]
        waiting = self._waiting.get(view.robot, [])
        self._waiting[view.robot] = [p for p in waiting if p.view != view]

    # ---- what is shown ---------------------------------------------------------------------------

    def shown(self, robot: str, without_server: bool = False) -> Picture | None:
        """The picture to show: the frozen one, else the newest that the server has taken; without
        a server the newest of all.
        """
        frozen = (self._frozen or {}).get(robot)
        if frozen is not None:
            return frozen.picture
        waiting = self._waiting.get(robot)
        return waiting[-1] if without_server and waiting else self._taken.get(robot)

    def waits(self, robot: str) -> bool:
        """Whether a picture has come whose view the server has not taken."""
        return bool(self._waiting.get(robot))

    def is_taken(self, view: ViewName) -> bool:
        """Whether the server has had a view, so that one can pick in it."""
        frozen, newest = (self._frozen or {}).get(view.robot), self._taken.get(view.robot)
        if frozen is not None and frozen.picture.view == view and frozen.taken:
            return True
        return self._server_has(view) or (newest is not None and newest.view == view)

    # ---- holding still ---------------------------------------------------------------------------

    def frozen_view(self, robot: str | None) -> ViewName | None:
        frozen = (self._frozen or {}).get(robot or "")
        return frozen.picture.view if frozen else None

    def keeping(self, robot: str) -> Keeping:
        """Whether the server keeps the frozen view of a robot."""
        frozen = (self._frozen or {}).get(robot)
        return frozen.keeping if frozen else ""

    @property
    def lost(self) -> bool:
        """Whether a frozen view is not kept."""
        return any(f.keeping == "not kept" for f in (self._frozen or {}).values())

    def freeze(
        self, now_s: float, seen: Sequence[Picture] = (), without_server: bool = False
    ) -> None:
        """Holds what is shown; `seen` is what the operator has before the eyes, which may be some
        pictures behind.
        """
        if self._frozen is not None:
            return
        pictures = {robot: self.shown(robot, without_server) for robot in self.pair}
        pictures |= {p.view.robot: p for p in seen if p.view.robot in pictures}
        self._frozen = {
            robot: Frozen(picture, self.is_taken(picture.view), now_s)
            for robot, picture in pictures.items()
            if picture is not None
        }

    def find(self, view: ViewName) -> Picture | None:
        """The picture of a certain view, if it is here."""
        frozen, taken = (self._frozen or {}).get(view.robot), self._taken.get(view.robot)
        known = (frozen.picture if frozen else None, taken, self._fetched.get(view))
        waiting = self._waiting.get(view.robot, ())
        return next((p for p in (*known, *waiting) if p is not None and p.view == view), None)

    def hold(self, pictures: Sequence[Picture], now_s: float) -> None:
        """Holds certain pictures of the pair, in place of what was shown."""
        self._frozen = {p.view.robot: Frozen(p, self.is_taken(p.view), now_s) for p in pictures}

    def thaw(self) -> None:
        self._frozen = None

    # ---- inside ----------------------------------------------------------------------------------

    def _server_has(self, view: ViewName) -> bool:
        newest = self._server.get(view.robot)
        return newest is not None and newest.epoch == view.epoch and newest.seq >= view.seq

    def _take(self, picture: Picture, now_s: float) -> bool:
        """Makes a picture the newest taken one; whether what is shown changed."""
        robot = picture.view.robot
        known = self._taken.get(robot)
        if known is not None and known.view.epoch == picture.view.epoch:
            if known.view.seq > picture.view.seq:
                return False
            if known.view == picture.view:
                self._taken[robot] = picture
                return False
        self._taken[robot] = picture
        if self._frozen is None:
            return True
        if robot in self._frozen:
            return False
        self._frozen[robot] = Frozen(picture, True, now_s)
        return True

    def _is_lost(
        self, frozen: Frozen, pinned: Container[ViewName], now_s: float, anew: bool
    ) -> bool:
        """Notes what the server says of a frozen view; whether it is now, first, known as lost."""
        view = frozen.picture.view
        frozen.taken |= view in pinned or self._server_has(view)
        if view in pinned or anew:
            frozen.asked_s = now_s
            frozen.keeping = "pinned" if view in pinned else ""
        elif now_s - frozen.asked_s > KEEP_S:
            frozen.keeping = "not kept"
        if frozen.keeping != "not kept" or frozen.told:
            return False
        frozen.told = True
        return True


def picture_of(held: Picture | Frozen) -> Picture:
    """The picture itself."""
    return held.picture if isinstance(held, Frozen) else held
