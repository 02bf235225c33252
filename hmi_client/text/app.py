"""The text client: panels around one session. It reads the session at its own rate."""

import time
from collections.abc import Callable

from textual.app import App, ComposeResult
from textual.binding import Binding
from textual.containers import Container, Horizontal, Vertical
from textual.widgets import Footer

from hmi_client.errors import OperatorError
from hmi_client.session import OperatorSession
from hmi_client.text.image_panel import ImagePanel
from hmi_client.text.list_panel import ListPanel
from hmi_client.text.look import CSS
from hmi_client.text.map_panel import MapPanel
from hmi_client.text.matrix_panel import MatrixPanel
from hmi_client.text.panel import PanelMixin
from hmi_client.text.status_panel import StatusPanel

SLOW_S = 0.5  # numbers that change faster cannot be read
THRESHOLD_STEP = 1.25


class FleetApp(App[None]):
    """Map, error matrix, images, list and status of one operator's session.

    Args:
        session: what is shown and commanded.
        fps: how often the session is looked at.
        failure: tells a bug of the connection, which ends the app.
    """

    CSS = CSS
    ENABLE_COMMAND_PALETTE = False
    TITLE = "fleetpose"
    BINDINGS = [  # noqa: RUF012, as Textual declares it
        Binding("n", "question(1)", "Next"),
        Binding("p", "question(-1)", "Prev"),
        Binding("u", "undo", "Undo"),
        Binding("r", "redo", "Redo"),
        Binding("x", "erase", "Erase"),
        Binding("c,escape", "cancel", "Cancel"),
        Binding("f", "freeze", "Freeze"),
        Binding("m", "maximise", "Max"),
        Binding("q", "quit", "Quit"),
        Binding("left_square_bracket", "threshold(-1)", "Hide"),
        Binding("right_square_bracket", "threshold(1)", "Show"),
        Binding("ctrl+c", "quit", show=False, priority=True),
    ]

    def __init__(
        self,
        session: OperatorSession,
        fps: float = 10.0,
        failure: Callable[[], Exception | None] = lambda: None,
    ) -> None:
        super().__init__()
        self.session = session
        self._period_s = 1.0 / fps
        self._failure = failure
        self._seen: dict[str, int] = {}
        self._late: dict[PanelMixin, float] = {}
        self.map = MapPanel(session)
        self.matrix = MatrixPanel(session)
        self.list = ListPanel(session)
        self.images = (ImagePanel(session, 0), ImagePanel(session, 1))
        self.status = StatusPanel(session)
        self.panels: tuple[PanelMixin, ...] = (self.map, self.matrix, self.list, *self.images)

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
        self.matrix.focus()
        self.set_interval(self._period_s, self.tick)

    def tick(self) -> None:
        """Repaints the panels whose topics have changed."""
        failure = self._failure()
        if failure is not None:
            raise failure
        now, revisions = time.monotonic(), self.session.revisions()
        changed = {topic for topic, n in revisions.items() if n != self._seen.get(topic, 0)}
        self._seen = revisions
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
        self.session.select(chosen.a, chosen.b)
        self.images[0].focus()
        self.tick()

    def on_image_panel_picked(self, picked: ImagePanel.Picked) -> None:
        """After the first half the other image is next, after the second the first one again."""
        self.images[0 if picked.complete else 1 - picked.side].focus()
        self.tick()

    def on_list_panel_shown(self, shown: ListPanel.Shown) -> None:
        pick = shown.entry.pick
        for panel, pixel in zip(self.images, (pick.pixel_i, pick.pixel_j), strict=True):
            panel.move_to(*pixel)

    def action_undo(self) -> None:
        self.session.undo()
        self.tick()

    def action_redo(self) -> None:
        self.session.redo()
        self.tick()

    def action_cancel(self) -> None:
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

    def action_maximise(self) -> None:
        self.query_one("#body").toggle_class("maximised")
        if self.focused in (self.map, self.matrix, self.list):
            self.images[0].focus()
