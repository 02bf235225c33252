"""The panels of one site around its desk, as the operator left them."""

from textual.app import ComposeResult
from textual.containers import Container, Horizontal, Vertical
from textual.widget import Widget

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.keymap import Place
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.tui.panels.image_panel import ImagePanel
from fleetpose.hmi_client.tui.panels.list_panel import ListPanel
from fleetpose.hmi_client.tui.panels.map_panel import MapPanel
from fleetpose.hmi_client.tui.panels.matrix_panel import MatrixPanel
from fleetpose.hmi_client.tui.panels.panel import PanelMixin
from fleetpose.hmi_client.tui.panels.status_panel import StatusPanel

SLOW_S = 0.5  # numbers that change faster cannot be read
NARROW = 120  # columns; below them images beside other panels are too small to pick in
_TO_IMAGES = ("next", "previous", "select", "pick", "look")
"""After these the keys go to the image at work."""


class SiteView(Vertical):
    """Map, error matrix, images, list and status of one operator's session.

    What its panels do is done at its own desk, whichever site is shown.

    Args:
        site: its name.
        desk: what is shown and commanded.
    """

    def __init__(self, site: str, desk: Desk) -> None:
        super().__init__()
        self.site = site
        self.desk, self.session = desk, desk.session
        self.map = MapPanel(desk, self.do)
        self.matrix = MatrixPanel(desk, self.do)
        self.list = ListPanel(desk, self.do)
        self.images = (ImagePanel(desk, 0, self.do), ImagePanel(desk, 1, self.do))
        self.status = StatusPanel(desk)
        self.panels: tuple[PanelMixin, ...] = (self.map, self.matrix, self.list, *self.images)
        self.body = Horizontal(id="body")
        self.last_focus: Widget = self.matrix
        self._seen: dict[str, int] = {}
        self._noticed = 0
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
        self.make_room()
        if self.display:
            self.screen.set_focus(panel)

    @property
    def place(self) -> Place:
        """Where the keys go."""
        if self.last_focus in self.images:
            return "images"
        places: dict[Widget, Place] = {self.map: "map", self.list: "list"}
        return places.get(self.last_focus, "matrix")

    def do(self, command: str, **args: object) -> None:
        """Carries a command out at the desk, and shows what came of it."""
        try:
            self.desk.do(command, **args)
        except OperatorError as error:
            self.notify(str(error), severity="warning", timeout=4)
            return
        if command in _TO_IMAGES or (command == "maximise" and self.desk.maximised):
            self.give_keys(self.images[self.desk.side])
        elif command == "overview":
            self.give_keys(self.matrix)
        self.make_room()

    # ---- painting --------------------------------------------------------------------------------

    def follow(self, now: float) -> None:
        """Repaints the panels whose topics have changed.

        Args:
            now: monotonic seconds.
        """
        self.desk.follow()
        notices, self._noticed = self.desk.notices_since(self._noticed)
        for notice in notices:
            severity = "warning" if notice.tone == "warn" else "information"
            self.notify(notice.text, severity=severity, timeout=3)
        revisions = self.session.revisions()
        changed = {topic for topic, n in revisions.items() if n != self._seen.get(topic, 0)}
        self._seen = revisions
        moved = {panel for panel in self.images if panel.follow()}
        for panel in self.panels:
            concerned = changed.intersection(panel.TOPICS)
            if concerned or panel in moved:
                wait = SLOW_S if concerned <= set(panel.SLOW) and panel not in moved else 0.0
                self._late[panel] = min(self._late.get(panel, now + wait), now + wait)
            if panel in self._late and now >= self._late[panel]:
                del self._late[panel]
                panel.repaint()
        self.status.repaint()

    def repaint(self) -> None:
        """Repaints everything."""
        for panel in (*self.panels, self.status):
            panel.repaint()

    def on_resize(self) -> None:
        self.make_room()

    def make_room(self) -> None:
        """Shows the panels that there is room for. On a narrow screen a pair that is being answered
        has all of it; `maximise` shows the other panels again.
        """
        narrow = self.app.size.width < NARROW
        alone = narrow and self.session.pair is not None and self.last_focus in self.images
        overview = self.desk.overview
        self.body.set_class(overview, "overview")
        self.body.set_class(not overview and self.desk.maximised != alone, "maximised")
        self.set_class(narrow, "narrow")
