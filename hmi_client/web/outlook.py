"""The newest frame of each kind and the pictures that are shown, numbered, so that a page knows
what it has not sent yet.
"""

import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.records import Pair, Picture
from fleetpose.hmi_client.web import frames, told
from fleetpose.protocol.messages import ViewName

ORDER = ("names", "list", "step", "assist", "pair", "questions", "health", "clock")
"""In which text frames are sent; the images of a pair come behind its list."""
FLEET = ("matrix", "poses")
QUALITIES = (100, 60, 35, 20)  # of JPEGs, the more the slower a page's link is
SLOW_S, QUICK_S = 0.6, 0.15  # until an image is drawn; a step of quality is less than between them
NUMBERED = 24  # pictures: those shown and a few before
SENT = (
    64  # pictures of which pages may speak: on both sides what 16 pages show, and what comes next
)


class Outlook:
    """One thread puts, any thread reads."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._frames: dict[str, tuple[int, str | bytes]] = {}
        self._count = 0

    def put(self, name: str, frame: told.Frame | None, always: bool = False) -> bool:
        """Takes a text frame; whether it is another one than before, or `always`."""
        if frame is None or (frame == self._values.get(name) and not always):
            return False
        self._values[name] = frame
        return self._take(name, told.text_of(frame))

    def renew(self, name: str) -> None:
        """The next text frame of this kind goes out also where it is as before."""
        self._values.pop(name, None)

    def put_fleet(self, desk: Desk) -> bool:
        """Makes matrix and map; whether one has changed."""
        session, fleet = desk.session, desk.session.fleet
        if fleet is None:
            return False
        robots = session.robots()
        asked = [(q.i, q.j) for q in fleet.questions]
        made = {
            "matrix": frames.matrix(fleet, robots, session.threshold_m, desk.quantity, asked),
            "poses": frames.poses(robots, session.poses(), fleet.anchor),
        }
        changed = [self._put_bytes(name, frame) for name, frame in made.items()]
        return any(changed)

    def value(self, name: str) -> Mapping[str, Any] | None:
        """The newest text frame of a kind, unpacked."""
        return self._values.get(name)

    def version(self, name: str) -> int:
        """The number of the newest frame of a kind; 0 without one."""
        return self._frames.get(name, (0, ""))[0]

    def since(self, name: str, version: int) -> tuple[int, str | bytes] | None:
        """The newest frame of a kind and its number, unless it was had."""
        known = self._frames.get(name)
        return known if known is not None and known[0] != version else None

    def _put_bytes(self, name: str, frame: bytes) -> bool:
        known = self._frames.get(name)
        return (known is None or known[1] != frame) and self._take(name, frame)

    def _take(self, name: str, frame: str | bytes) -> bool:
        self._count += 1
        self._frames[name] = self._count, frame
        return True


@dataclass(frozen=True)
class Shown:
    """A picture on a side; `id` is its number."""

    id: int
    pair: Pair
    picture: Picture


class Pictures:
    """Numbers what is shown, and remembers what was sent until a page has surely drawn something
    newer, however long that takes on its link.
    """

    def __init__(self) -> None:
        self.shown: tuple[Shown | None, Shown | None] = (None, None)
        self._sent: OrderedDict[int, Picture] = OrderedDict()
        self._numbers: OrderedDict[ViewName, int] = OrderedDict()
        self._count = 0
        self._lock = threading.Lock()  # pages are sent to by another thread than theirs who follows

    def follow(self, desk: Desk) -> bool:
        """Takes what a desk shows now; whether that is something else."""
        before = self.shown
        self.shown = self._of(desk, 0), self._of(desk, 1)
        return self.shown != before

    def keep(self, shown: Shown) -> None:
        """A page is sent a picture, and may speak of it from now on."""
        with self._lock:
            self._sent[shown.id] = shown.picture
            self._sent.move_to_end(shown.id)
            if len(self._sent) > SENT:
                self._sent.popitem(last=False)

    def seen(self, id: int) -> Picture:
        """The picture that a page calls by a number.

        Raises:
            OperatorError: it was too long ago.
        """
        picture = self.known(id)
        if picture is None:
            raise OperatorError("that image has gone: look at the newest one and pick again")
        return picture

    def known(self, id: int) -> Picture | None:
        """The picture that a page calls by a number; none if it was too long ago."""
        with self._lock:
            return self._sent.get(id)

    def _of(self, desk: Desk, side: int) -> Shown | None:
        picture, pair = desk.picture(side), desk.session.pair
        if picture is None or pair is None:
            return None
        if picture.view not in self._numbers:
            self._count += 1
            self._numbers[picture.view] = self._count
            if len(self._numbers) > NUMBERED:
                self._numbers.popitem(last=False)
        return Shown(self._numbers[picture.view], pair, picture)


class Thrift:
    """Images for a page with a slow link: of the same size, so that picks stay exact, but
    compressed more, so that what is seen is not old and clicks need not wait behind it.
    """

    def __init__(self) -> None:
        self._level = 0
        self.known = False  # how quick the link is; until then images go one by one

    @property
    def quality(self) -> int:
        """Of JPEGs; 100 leaves them untouched."""
        return QUALITIES[self._level]

    def drawn(self, took_s: float) -> None:
        """The page has drawn an image so long after it was sent."""
        self.known = True
        step = round(took_s / SLOW_S) if took_s > SLOW_S else -1 if took_s < QUICK_S else 0
        self._level = min(max(self._level + step, 0), len(QUALITIES) - 1)


def compressed(picture: Picture, quality: int) -> Picture:
    """A picture in fewer bytes; the same one where they would not be fewer."""
    image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        return picture
    done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    smaller = done and len(jpeg) < len(picture.jpeg)
    return replace(picture, jpeg=jpeg.tobytes()) if smaller else picture
