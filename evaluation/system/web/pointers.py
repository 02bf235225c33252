"""Mouse, pen and finger as the browser is told of them by its own protocol, as from a device."""

from typing import Any, Literal

Kind = Literal["mouse", "pen", "touch"]
KINDS: tuple[Kind, ...] = ("mouse", "pen", "touch")
_DRAG_STEPS = 6


class Pointer:
    """One pointer on a page. Places are CSS pixels; a device tells whole pixels of the screen only.

    Args:
        page: where it points.
        kind: what it is.
        dpr: pixels of the screen per CSS pixel.
    """

    def __init__(self, page: Any, kind: Kind, dpr: float) -> None:
        self.kind: Kind = kind
        self._dpr = dpr
        self._protocol = page.context.new_cdp_session(page)

    def click(self, x: float, y: float) -> None:
        """Down and up at a place."""
        if self.kind == "touch":
            self._touch("touchStart", x, y)
            self._touch("touchEnd")
            return
        self._mouse("mouseMoved", x, y)
        self._mouse("mousePressed", x, y)
        self._mouse("mouseReleased", x, y)

    def drag(self, x: float, y: float, dx: float, dy: float) -> None:
        """A finger goes from a place by so much."""
        self._touch("touchStart", x, y)
        for k in range(1, _DRAG_STEPS + 1):
            self._touch("touchMove", x + dx * k / _DRAG_STEPS, y + dy * k / _DRAG_STEPS)
        self._touch("touchEnd")

    def _mouse(self, type: str, x: float, y: float) -> None:
        told = {"x": self.whole(x), "y": self.whole(y), "pointerType": self.kind}
        button = {} if type == "mouseMoved" else {"button": "left", "clickCount": 1}
        held = {"buttons": 1} if type == "mousePressed" else {}
        self._protocol.send("Input.dispatchMouseEvent", {"type": type, **told, **button, **held})

    def _touch(self, type: str, x: float | None = None, y: float = 0.0) -> None:
        at = [] if x is None else [{"x": self.whole(x), "y": self.whole(y)}]
        self._protocol.send("Input.dispatchTouchEvent", {"type": type, "touchPoints": at})

    def whole(self, place: float) -> float:
        """The nearest place that a device can tell, CSS pixels."""
        return round(place * self._dpr) / self._dpr
