"""The panels of one site around its session, as the operator left them."""

from collections.abc import Mapping
from dataclasses import replace

from textual.app import ComposeResult
from textual.containers import Container, Horizontal, Vertical
from textual.widget import Widget

from fleetpose.hmi_client.assist.pick_assist import Expected, PickAssist
from fleetpose.hmi_client.assist.suggestions import Proposal, Suggestions
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.panels.image_panel import ImagePanel
from fleetpose.hmi_client.tui.panels.list_panel import ListPanel
from fleetpose.hmi_client.tui.panels.map_panel import MapPanel
from fleetpose.hmi_client.tui.panels.matrix_panel import MatrixPanel
from fleetpose.hmi_client.tui.panels.panel import PanelMixin
from fleetpose.hmi_client.tui.panels.status_panel import StatusPanel

SLOW_S = 0.5  # numbers that change faster cannot be read


class SiteView(Vertical):
    """Map, error matrix, images, list and status of one operator's session.

    What its panels tell is heard here, so that it goes to their own site whichever is shown.

    Args:
        site: its name.
        session: what is shown and commanded.
        keys: how the keys of the commands are called, by the commands' ids.
    """

    def __init__(self, site: str, session: OperatorSession, keys: Mapping[str, str]) -> None:
        super().__init__()
        self.site = site
        self.session = session
        self.guide = PickAssist(session)
        self.proposals = Suggestions(session, self.guide)
        self.map = MapPanel(session)
        self.matrix = MatrixPanel(session)
        self.list = ListPanel(session)
        self.images = (ImagePanel(session, self.guide, 0), ImagePanel(session, self.guide, 1))
        self.status = StatusPanel(session, self.proposals, keys)
        self.panels: tuple[PanelMixin, ...] = (self.map, self.matrix, self.list, *self.images)
        self.body = Horizontal(id="body")
        self.last_focus: Widget = self.matrix
        self._proposed: Proposal | None = None
        self._expected: Expected | None = None
        self._seen: dict[str, int] = {}
        self._late: dict[PanelMixin, float] = {}

    def compose(self) -> ComposeResult:
        with self.body:
            yield self.map
            with Vertical(id="middle"):
                yield self.matrix
                yield self.list
            with Container(id="images"):
                yield from self.images
        yield self.status

    def give_keys(self, panel: Widget) -> None:
        """The keys go to a panel: at once, or when this site is shown again."""
        self.last_focus = panel
        if self.display:
            self.screen.set_focus(panel)

    # ---- painting --------------------------------------------------------------------------------

    def follow(self, now: float) -> None:
        """Repaints the panels whose topics have changed.

        Args:
            now: monotonic seconds.
        """
        revisions = self.session.revisions()
        changed = {topic for topic, n in revisions.items() if n != self._seen.get(topic, 0)}
        self._seen = revisions
        self._follow_proposals()
        if "depths" in changed:
            self._expect(again=True)
        for panel in self.panels:
            concerned = changed.intersection(panel.TOPICS)
            if concerned:
                wait = SLOW_S if concerned <= set(panel.SLOW) else 0.0
                self._late[panel] = min(self._late.get(panel, now + wait), now + wait)
            if panel in self._late and now >= self._late[panel]:
                del self._late[panel]
                panel.repaint()
        self.status.repaint()

    def repaint(self) -> None:
        """Repaints everything."""
        for panel in (*self.panels, self.status):
            panel.repaint()

    def toggle_overview(self) -> None:
        """All pairs at once, in colours, in place of the other panels; or these again."""
        self.matrix.overview = shown = not self.matrix.overview
        self.body.set_class(shown, "overview").remove_class("maximised")
        self.give_keys(self.matrix)

    def toggle_maximised(self) -> None:
        """The images only, or all panels."""
        if self.matrix.overview:
            self.toggle_overview()
        self.body.toggle_class("maximised")
        if self.app.focused in (self.map, self.matrix, self.list):
            self.give_keys(self.images[0])

    # ---- picking ---------------------------------------------------------------------------------

    def on_matrix_panel_chosen(self, chosen: MatrixPanel.Chosen) -> None:
        if self.matrix.overview:
            self.toggle_overview()
        self.session.select(chosen.a, chosen.b)
        self.give_keys(self.images[0])

    def on_image_panel_picked(self, picked: ImagePanel.Picked) -> None:
        """After the first half the other image is next, the cursor where the point is expected;
        after the second the first one again.
        """
        self.give_keys(self.images[0 if picked.complete else 1 - picked.side])
        self._expect()

    def _expect(self, again: bool = False) -> None:
        """Puts the other image's cursor where the point is expected; `again`, once more is known,
        only where the operator has not moved it since.
        """
        before = self._expected
        if again and (before is None or self.images[before.side].cursor != before.pixel):
            return
        self._expected = expected = self.guide.expected()
        for panel in self.images:
            panel.expected = expected
        if expected is not None:
            self.images[expected.side].move_to(*expected.pixel)
            here = self.images[expected.side].cursor  # inside the image, whatever was expected
            self._expected = replace(expected, pixel=here)

    def on_list_panel_shown(self, shown: ListPanel.Shown) -> None:
        """Shows the views that an entry was clicked in, the cursors at its pixels."""
        pick = shown.entry.pick
        self.session.hold(pick.view_i, pick.view_j)
        for panel, pixel in zip(self.images, (pick.pixel_i, pick.pixel_j), strict=True):
            panel.move_to(*pixel)

    # ---- suggestions -----------------------------------------------------------------------------

    def on_image_panel_suggestion(self, wanted: ImagePanel.Suggestion) -> None:
        """Tab accepts the suggestion on the screen, Shift-Tab skips it; the first begins."""
        try:
            if self.proposals.current is not None and wanted.step > 0:
                self.proposals.accept(self.images[0].cursor, self.images[1].cursor)
            elif self.proposals.current is not None:
                self.proposals.skip()
            elif not self.proposals.waiting:
                self.proposals.begin()
        except OperatorError as error:
            self.notify(str(error), severity="warning", timeout=4)

    def _follow_proposals(self) -> None:
        """Shows a suggestion by the cursors, once its pictures are there."""
        self.proposals.follow()
        proposal = self.proposals.current
        if proposal == self._proposed:
            return
        self._proposed = proposal
        if proposal is not None:
            pixels = (proposal.pixel_i, proposal.pixel_j)
            for panel, pixel in zip(self.images, pixels, strict=True):
                panel.repaint()  # the picture may be another one
                panel.move_to(*pixel)
