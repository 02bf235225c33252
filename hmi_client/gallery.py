"""The pictures of the selected pair, and holding them still while the operator picks."""

from hmi_client.model import Pair, Picture
from protocol.messages import ViewName

STALE_S = 10.0  # a picture of an earlier selection is shown again only if it is younger


class Gallery:
    """The newest picture per robot, and behind it the frozen ones that are shown instead."""

    def __init__(self) -> None:
        self.pair: Pair = ("", "")
        self.held = False
        self._newest: dict[str, Picture] = {}
        self._frozen: dict[str, Picture] | None = None

    @property
    def frozen(self) -> bool:
        return self._frozen is not None

    def show(self, pair: Pair, now_s: float) -> None:
        """Turns to a pair; pictures of others and stale ones are dropped, a freeze is released."""
        self.pair, self.held, self._frozen = pair, False, None
        self._newest = {
            robot: picture
            for robot, picture in self._newest.items()
            if robot in pair and now_s - picture.received_s < STALE_S
        }

    def put(self, picture: Picture) -> bool:
        """Takes a picture; whether what is shown changed.

        A frozen gallery still shows the first picture of a robot.
        """
        robot = picture.view.robot
        if robot not in self.pair:
            return False
        known = self._newest.get(robot)
        self._newest[robot] = picture
        if known is not None and known.view == picture.view:
            return False
        if self._frozen is None:
            return True
        if robot in self._frozen:
            return False
        self._frozen[robot] = picture
        return True

    def shown(self, robot: str) -> Picture | None:
        """The picture to show and to pick in: the frozen one, else the newest."""
        frozen = (self._frozen or {}).get(robot)
        return frozen or self._newest.get(robot)

    def frozen_view(self, robot: str | None) -> ViewName | None:
        picture = (self._frozen or {}).get(robot or "")
        return picture.view if picture else None

    def freeze(self) -> None:
        if self._frozen is None:
            self._frozen = dict(self._newest)

    def thaw(self) -> None:
        self._frozen = None
