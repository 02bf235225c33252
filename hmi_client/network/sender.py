"""What goes out: updates until they are receipted, the selection, and which images are wanted."""

import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import OperatorUpdate, Selection
from fleetpose.protocol.transport import Link, Publisher, Sample

REPEAT_S = 1.0  # an update is offered again after this long without a receipt
RETELL_S = 5.0  # a selection is told again after this long: servers and operators forget them


class Sender:
    """Follows the session; runs in a thread of its own, because a put may wait for the link. Of who
    only looks, nothing goes out.

    Args:
        session: what is followed.
        keys: the keys of the site.
        link: where it goes.
        on_image: takes images of the selected robots, and only of these, as they arrive.
    """

    def __init__(
        self,
        session: OperatorSession,
        keys: Keys,
        link: Link,
        on_image: Callable[[Sample], None],
    ) -> None:
        self._session = session
        self._keys = keys
        self._link = link
        self._on_image = on_image
        self._updates: Publisher | None = None
        self._selection: Publisher | None = None
        if session.acts:
            operator = session.operator
            self._updates = link.latched(keys.updates(operator), block=True, history=100)
            self._selection = link.latched(keys.selection(operator), block=True)
        self._offered_s: dict[tuple[str, int], float] = {}
        self._told: Selection | None = None
        self._told_s = 0.0
        self._told_to: str | None = None
        self._images: dict[str, Any] = {}

    def run(self, stop: threading.Event) -> None:
        """Sends until told to stop."""
        while not stop.is_set():
            seen = self._session.revisions()
            self._follow_selection()
            self._offer_updates()
            self._session.wait_change(seen, ("selection", "updates"), REPEAT_S / 4)
        self._want_images(())
        if not self._session.unconfirmed:  # else the views of what is on its way stay held
            self._leave()

    def _leave(self) -> None:
        """Tells that the operator looks at nothing any more."""
        nothing = {"i": None, "j": None, "view_i": None, "view_j": None}
        left = self._session.selection().model_copy(update=nothing)
        self._tell(left)

    def _offer_updates(self) -> None:
        """Offers open updates in order, and again while no receipt covers them."""
        if self._updates is None:
            return
        now = time.monotonic()
        offered = {}
        for update in self._session.open_updates():
            name = (update.session, update.n)
            offered[name] = self._offered_s.get(name, now - REPEAT_S)
            if now - offered[name] >= REPEAT_S:
                self._updates.put(pack(update), encoding_of(OperatorUpdate))
                offered[name] = now
        self._offered_s = offered

    def _follow_selection(self) -> None:
        """Tells the selection when it changes, to each new server, and again and again."""
        selection, fleet = self._session.selection(), self._session.fleet
        server = fleet.server_epoch if fleet else None
        late = time.monotonic() - self._told_s >= RETELL_S
        if selection != self._told:
            self._want_images(robot for robot in (selection.i, selection.j) if robot)
        elif server == self._told_to and not late:
            return
        self._tell(selection)
        self._told, self._told_to, self._told_s = selection, server, time.monotonic()

    def _tell(self, selection: Selection) -> None:
        if self._selection is not None:
            self._selection.put(pack(selection), encoding_of(Selection))

    def _want_images(self, robots: Iterable[str]) -> None:
        wanted = set(robots)
        for robot in set(self._images) - wanted:
            self._images.pop(robot).undeclare()
        for robot in wanted - set(self._images):
            self._images[robot] = self._link.subscribe_bulk(self._keys.image(robot), self._on_image)
