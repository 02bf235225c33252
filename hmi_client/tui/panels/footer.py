"""The last line: the keys that work here, help and the way out first, as many as there is room."""

from collections.abc import Callable

from rich.segment import Segment
from textual import events
from textual.strip import Strip

from fleetpose.hmi_client.desk.keymap import Command, KeyMap, Place, of_place, printed
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import PanelMixin

_FIRST = ("help", "quit")


class KeyLine(PanelMixin):
    """Painted at every tick, since it follows the focus. A click on a key is that key.

    Args:
        keymap: the keys.
        several: whether there are other sites to go to.
        press: carries a command out.
    """

    def __init__(self, keymap: KeyMap, several: bool, press: Callable[[Command], None]) -> None:
        super().__init__(id="keys")
        self.place: Place = "matrix"
        self._keymap, self._several, self._press = keymap, several, press
        self._ends: list[tuple[int, Command]] = []

    def commands(self) -> list[Command]:
        """What there is to show, the most useful first."""
        everywhere = [c for c in of_place("everywhere") if c.shown]
        first = [c for c in everywhere if c.id in _FIRST]
        rest = [c for c in everywhere if c.id not in _FIRST and (self._several or c.id != "site")]
        return [*first, *(c for c in of_place(self.place) if c.shown), *rest]

    def paint(self) -> list[Strip]:
        width, at = self.extent.width, 0
        segments: list[Segment] = []
        self._ends = []
        for command in self.commands():
            key = f" {printed(self._keymap.keys(command)[0])} "
            label = f"{command.label} "
            if at + len(key) + len(label) > width:
                break
            segments += [Segment(key, style("focus", "why", True))]
            segments += [Segment(label, style("on why", "why"))]
            at += len(key) + len(label)
            self._ends.append((at, command))
        return [Strip(segments).adjust_cell_length(width, style("on why", "why"))]

    def on_click(self, event: events.Click) -> None:
        command = next((command for end, command in self._ends if event.x < end), None)
        if command is not None:
            self._press(command)
