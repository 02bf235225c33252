"""One line above all: the operator's sites, which of them is shown, and how the others are."""

from collections.abc import Mapping

from rich.segment import Segment
from textual.events import Click
from textual.message import Message
from textual.strip import Strip

from fleetpose.hmi_client.desk.words import site_text
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import PanelMixin

GAP = "  "


class SitesPanel(PanelMixin):
    """Painted at every tick, since silence has no event. A click shows a site.

    Args:
        sites: the sessions by the names of their sites.
        shown: which site is shown.
        keys: how the keys of the commands are called, by the commands' ids.
    """

    class Chosen(Message):
        """A site was clicked."""

        def __init__(self, site: str) -> None:
            super().__init__()
            self.site = site

    def __init__(
        self, sites: Mapping[str, OperatorSession], shown: str, keys: Mapping[str, str]
    ) -> None:
        super().__init__(id="sites")
        self._sites = sites
        self.shown = shown
        self._key = keys["site"]
        self._ends: dict[str, int] = {}

    def paint(self) -> list[Strip]:
        width = self.extent.width
        full = {name: f" {name}  {site_text(session)} " for name, session in self._sites.items()}
        lengths = sum(len(text) + len(GAP) for text in full.values())
        if lengths > width:  # the shown one alone has room for its sentence
            full = {name: full[name] if name == self.shown else f" {name} " for name in full}
        segments, at = [], 0
        for name, text in full.items():
            segments += [Segment(text, self._style(name)), Segment(GAP, style("on why", "why"))]
            at += len(text) + len(GAP)
            self._ends[name] = at
        key = f"{self._key} next site "
        if at + len(key) <= width:
            segments.append(Segment(key.rjust(width - at), style("dim", "why")))
        return [Strip(segments).adjust_cell_length(width, style("on why", "why"))]

    def _style(self, name: str):  # noqa: ANN202, rich's
        session = self._sites[name]
        if name == self.shown:
            return style("on step", "step", True)
        if session.silent:
            return style("on red", "red", True)
        asks = session.fleet is not None and session.fleet.questions
        return style("waiting" if asks or session.unconfirmed else "on why", "why", bool(asks))

    def on_click(self, event: Click) -> None:
        site = next((name for name, end in self._ends.items() if event.x < end), None)
        if site is not None:
            self.post_message(self.Chosen(site))
