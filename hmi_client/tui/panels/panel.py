"""What the panels share: they hold finished strips and repaint only the rows that changed."""

from collections.abc import Callable, Sequence

from rich.segment import Segment
from rich.style import Style
from textual.filter import LineFilter
from textual.geometry import Region, Size
from textual.strip import Strip
from textual.widget import Widget

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.drawing.palette import style

Do = Callable[..., None]
"""Carries out a command of the desk with its arguments, and tells what refuses it."""


class PanelMixin(Widget):
    """A widget over the line API that reads the session.

    `TOPICS` says which changes of the session concern it; `SLOW` which of them may wait half a
    second. `paint` returns the strips of its content.
    """

    TOPICS: tuple[str, ...] = ()
    SLOW: tuple[str, ...] = ()
    session: OperatorSession

    def paint(self) -> list[Strip]:
        """The strips of the whole content area."""
        raise NotImplementedError

    def repaint(self) -> None:
        """Paints anew and refreshes only what differs from the screen."""
        extent = self.extent
        if extent.width < 2 or extent.height < 1:
            return
        strips = self.paint()
        old, size = self._shown()
        self._strips, self._painted = strips, extent
        if size != extent or len(old) != len(strips):
            self.refresh()
            return
        changed = [
            Region(0, y, extent.width, 1)
            for y, (a, b) in enumerate(zip(old, strips, strict=True))
            if a is not b and a != b
        ]
        if changed:
            self.refresh(*changed)

    def action_do(self, command: str) -> None:
        """A command by its key, as far as it is a panel's."""

    @property
    def extent(self) -> Size:
        """Size of the content in cells, without borders and scroll bars."""
        return self.scrollable_content_region.size

    def _shown(self) -> tuple[list[Strip], Size | None]:
        return getattr(self, "_strips", []), getattr(self, "_painted", None)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """None: what is painted is made for the theme in use."""
        return ()

    def render_line(self, y: int) -> Strip:
        strips, _ = self._shown()
        width = self.size.width
        if y < len(strips):
            return strips[y].adjust_cell_length(width, style("text"))
        return Strip.blank(width, style("text"))

    def on_resize(self) -> None:
        self.repaint()

    def on_focus(self) -> None:
        self.repaint()

    def on_blur(self) -> None:
        self.repaint()

    def title(self, text: str) -> None:
        """Sets the border's title if it is another one: setting it repaints the border."""
        if self.border_title != text:
            self.border_title = text

    def subtitle(self, text: str) -> None:
        """The same for the text in the lower border."""
        if self.border_subtitle != text:
            self.border_subtitle = text


class Panel(PanelMixin, can_focus=True):
    """A panel without scroll bars."""


def line(text: str, width: int, paint: Style) -> Strip:
    """One line of one style, cut or filled to the width."""
    cut = text if len(text) <= width else text[: width - 1] + "…"
    return Strip([Segment(cut.ljust(width), paint)], width)
