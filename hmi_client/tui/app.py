"""The text client: panels around one session. It reads the session at its own rate."""

import time
from collections.abc import Callable
from dataclasses import replace

from textual.app import App, ComposeResult
from textual.containers import Container, Horizontal, Vertical
from textual.driver import Driver
from textual.widgets import Footer

from fleetpose.hmi_client.assist.pick_assist import Expected, PickAssist
from fleetpose.hmi_client.assist.suggestions import Proposal, Suggestions
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.panels.image_panel import ImagePanel
from fleetpose.hmi_client.tui.panels.list_panel import ListPanel
from fleetpose.hmi_client.tui.panels.map_panel import MapPanel
from fleetpose.hmi_client.tui.panels.matrix_panel import MatrixPanel
from fleetpose.hmi_client.tui.panels.pages import Page, WhyPages, events_text, help_text
from fleetpose.hmi_client.tui.panels.panel import PanelMixin
from fleetpose.hmi_client.tui.panels.status_panel import StatusPanel
from fleetpose.hmi_client.tui.stylesheet import CSS
from fleetpose.hmi_client.tui.terminal.driver import PatientDriver

SLOW_S = 0.5  # numbers that change faster cannot be read
THRESHOLD_STEP = 1.25


class FleetApp(App[None]):
    """Map, error matrix, images, list and status of one operator's session.

    Args:
        session: what is shown and commanded.
        fps: how often the session is looked at.
        failure: tells a bug of the connection, which ends the app.
        keymap: the keys of the commands.
        driver: of the terminal; default: Textual's choice.
    """

    CSS = CSS
    ENABLE_COMMAND_PALETTE = False
    TITLE = "fleetpose"
    BINDINGS = bindings.EVERYWHERE  # pyright: ignore[reportAssignmentType]

    def __init__(
        self,
        session: OperatorSession,
        fps: float = 10.0,
        failure: Callable[[], Exception | None] = lambda: None,
        driver: type[Driver] | None = None,
        keymap: bindings.KeyMap = bindings.KeyMap({}),  # noqa: B008, it cannot be changed
    ) -> None:
        super().__init__(driver_class=driver)
        self.keymap = keymap
        self.session = session
        self._period_s = 1.0 / fps
        self._failure = failure
        self._seen: dict[str, int] = {}
        self._late: dict[PanelMixin, float] = {}
        self.guide = PickAssist(session)
        self.proposals = Suggestions(session, self.guide)
        self._proposed: Proposal | None = None
        self._expected: Expected | None = None
        self.map = MapPanel(session)
        self.matrix = MatrixPanel(session)
        self.list = ListPanel(session)
        self.images = (ImagePanel(session, self.guide, 0), ImagePanel(session, self.guide, 1))
        self.status = StatusPanel(session, self.proposals, keymap.names())
        self.panels: tuple[PanelMixin, ...] = (self.map, self.matrix, self.list, *self.images)

    def get_css_variables(self) -> dict[str, str]:
        """Textual's own, and the colours of the theme in use."""
        return super().get_css_variables() | palette.variables()

    def compose(self) -> ComposeResult:
        with Horizontal(id="body"):
            yield self.map
            with Vertical(id="middle"):
                yield self.matrix
                yield self.list
            with Container(id="images"):
                yield from self.images
        yield self.status
        yield Footer(compact=True)

    def on_mount(self) -> None:
        self.set_keymap(dict(self.keymap.changed))
        self.matrix.focus()
        self.set_interval(self._period_s, self.tick)

    def on_resize(self) -> None:
        if isinstance(self._driver, PatientDriver):
            self._driver.forget()

    def action_redraw(self) -> None:
        """Draws all of the screen again, whatever the terminal shows."""
        self.on_resize()
        self.screen.refresh()

    def tick(self) -> None:
        """Repaints the panels whose topics have changed; not while the terminal still draws what it
        was given before: a slow one gets fewer pictures, not late ones.
        """
        failure = self._failure()
        if failure is not None:
            raise failure
        if isinstance(self._driver, PatientDriver) and self._driver.behind:
            return
        now, revisions = time.monotonic(), self.session.revisions()
        changed = {topic for topic, n in revisions.items() if n != self._seen.get(topic, 0)}
        self._seen = revisions
        self._follow_proposals()
        if "depths" in changed:
            self._expect(again=True)
        with self.batch_update():
            for panel in self.panels:
                concerned = changed.intersection(panel.TOPICS)
                if concerned:
                    wait = SLOW_S if concerned <= set(panel.SLOW) else 0.0
                    self._late[panel] = min(self._late.get(panel, now + wait), now + wait)
                if panel in self._late and now >= self._late[panel]:
                    del self._late[panel]
                    panel.repaint()
            self.status.repaint()

    # ---- commands --------------------------------------------------------------------------------

    def action_question(self, step: int) -> None:
        if self.session.next_question(step):
            self.images[0].focus()
        else:
            self.notify("The server asks nothing at present.", timeout=3)
        self.tick()

    def on_matrix_panel_chosen(self, chosen: MatrixPanel.Chosen) -> None:
        if self.matrix.overview:
            self.action_overview()
        self.session.select(chosen.a, chosen.b)
        self.images[0].focus()
        self.tick()

    def on_image_panel_picked(self, picked: ImagePanel.Picked) -> None:
        """After the first half the other image is next, the cursor where the point is expected;
        after the second the first one again.
        """
        self.images[0 if picked.complete else 1 - picked.side].focus()
        self._expect()
        self.tick()

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
        self.tick()

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

    def on_list_panel_shown(self, shown: ListPanel.Shown) -> None:
        """Shows the views that an entry was clicked in, the cursors at its pixels."""
        pick = shown.entry.pick
        self.session.hold(pick.view_i, pick.view_j)
        for panel, pixel in zip(self.images, (pick.pixel_i, pick.pixel_j), strict=True):
            panel.move_to(*pixel)

    def action_panel(self, number: int) -> None:
        """The keys go to a panel: map, matrix, list, or one of the two images."""
        (self.map, self.matrix, self.list, *self.images)[number - 1].focus()

    # ---- pages -----------------------------------------------------------------------------------

    def action_help(self) -> None:
        self.push_screen(Page("keys and signs", lambda: help_text(self.keymap)))

    def action_events(self) -> None:
        self.push_screen(Page("events, the newest first", lambda: events_text(self.session)))

    def action_why(self) -> None:
        """Why the robot under the matrix's cursor, or of the selected pair, is located or not."""
        robots = self.session.robots()
        if not robots:
            self.notify("No robot is known yet.", timeout=3)
            return
        row = min(self.matrix.cursor[0], len(robots) - 1)
        robot = self.session.pair[0] if self.session.pair else robots[row]
        pages = WhyPages(self.session, robot if robot in robots else robots[row])
        self.push_screen(Page("why is it located, or not", pages.text, pages.step))

    def action_undo(self) -> None:
        self.session.undo()
        self.tick()

    def action_redo(self) -> None:
        self.session.redo()
        self.tick()

    def action_cancel(self) -> None:
        self.proposals.end()
        self.session.cancel()
        self.tick()

    def action_freeze(self) -> None:
        self.session.toggle_freeze()
        self.tick()

    def action_erase(self) -> None:
        """Erases the list's current entry, or in an image the one nearest to the cursor."""
        panel = self.focused
        entry = panel.nearest() if isinstance(panel, ImagePanel) else self.list.current()
        if entry is None or entry.id is None or self.session.pair is None:
            self.notify("There is no confirmed correspondence to erase here.", timeout=3)
            return
        try:
            self.session.erase(self.session.pair, entry.id)
        except OperatorError as error:
            self.notify(str(error), severity="warning", timeout=4)
        self.tick()

    def action_threshold(self, direction: int) -> None:
        self.session.set_threshold(self.session.threshold_m * THRESHOLD_STEP**direction)
        self.tick()

    def action_overview(self) -> None:
        """All pairs at once, in colours, in place of the other panels; or these again."""
        self.matrix.overview = shown = not self.matrix.overview
        self.query_one("#body").set_class(shown, "overview").remove_class("maximised")
        self.matrix.focus()

    def action_maximise(self) -> None:
        if self.matrix.overview:
            self.action_overview()
        self.query_one("#body").toggle_class("maximised")
        if self.focused in (self.map, self.matrix, self.list):
            self.images[0].focus()
