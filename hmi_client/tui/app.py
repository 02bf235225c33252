"""The text client: the panels of one site or of several. It reads the sessions at its own rate."""

import time
from collections.abc import Callable, Mapping

from textual.app import App, ComposeResult
from textual.driver import Driver
from textual.widgets import Footer

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
from fleetpose.hmi_client.tui.panels.sites_panel import SitesPanel
from fleetpose.hmi_client.tui.panels.status_panel import StatusPanel
from fleetpose.hmi_client.tui.site_view import SiteView
from fleetpose.hmi_client.tui.stylesheet import CSS
from fleetpose.hmi_client.tui.terminal.driver import PatientDriver

THRESHOLD_STEP = 1.25


class FleetApp(App[None]):
    """Shows one site of an operator's; all keys and clicks are for the one that is shown.

    Args:
        sites: the operator's session at each site, by its name; the first is shown first.
        fps: how often the sessions are looked at.
        failure: tells a bug of a connection, which ends the app.
        keymap: the keys of the commands.
        driver: of the terminal; default: Textual's choice.
    """

    CSS = CSS
    ENABLE_COMMAND_PALETTE = False
    TITLE = "fleetpose"
    BINDINGS = bindings.EVERYWHERE  # pyright: ignore[reportAssignmentType]

    def __init__(
        self,
        sites: Mapping[str, OperatorSession],
        fps: float = 10.0,
        failure: Callable[[], Exception | None] = lambda: None,
        driver: type[Driver] | None = None,
        keymap: bindings.KeyMap = bindings.KeyMap({}),  # noqa: B008, it cannot be changed
    ) -> None:
        super().__init__(driver_class=driver)
        self.keymap = keymap
        self._period_s = 1.0 / fps
        self._failure = failure
        names = keymap.names()
        self.views = {name: SiteView(name, session, names) for name, session in sites.items()}
        self.view = next(iter(self.views.values()))
        self.sites = SitesPanel(sites, self.view.site, names)

    # ---- what is shown ---------------------------------------------------------------------------

    @property
    def session(self) -> OperatorSession:
        """Of the site that is shown."""
        return self.view.session

    @property
    def map(self) -> MapPanel:
        return self.view.map

    @property
    def matrix(self) -> MatrixPanel:
        return self.view.matrix

    @property
    def list(self) -> ListPanel:
        return self.view.list

    @property
    def images(self) -> tuple[ImagePanel, ImagePanel]:
        return self.view.images

    @property
    def status(self) -> StatusPanel:
        return self.view.status

    @property
    def panels(self) -> tuple[PanelMixin, ...]:
        return self.view.panels

    def get_css_variables(self) -> dict[str, str]:
        """Textual's own, and the colours of the theme in use."""
        return super().get_css_variables() | palette.variables()

    def compose(self) -> ComposeResult:
        if len(self.views) > 1:
            yield self.sites
        for view in self.views.values():
            view.display = view is self.view
            yield view
        yield Footer(compact=True)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """There is no other site to go to where there is but one."""
        return action != "site" or len(self.views) > 1

    def on_mount(self) -> None:
        self.set_keymap(dict(self.keymap.changed))
        self.view.give_keys(self.matrix)
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
        with self.batch_update():
            self.view.follow(time.monotonic())
            if len(self.views) > 1:
                self.sites.repaint()

    # ---- sites -----------------------------------------------------------------------------------

    def action_site(self, step: int) -> None:
        """Shows the next site (-1: the one before)."""
        names = list(self.views)
        self.show_site(names[(names.index(self.view.site) + step) % len(names)])

    def on_sites_panel_chosen(self, chosen: SitesPanel.Chosen) -> None:
        self.show_site(chosen.site)

    def show_site(self, name: str) -> None:
        """Shows a site as it was left. The keys are its own before the next one is read."""
        left, self.view = self.view, self.views[name]
        self.sites.shown = name
        if left is self.view:
            return
        left.last_focus = self.focused or left.last_focus
        with self.batch_update():
            left.display, self.view.display = False, True
            self.view.give_keys(self.view.last_focus)
            self.view.repaint()
        self.tick()

    # ---- commands --------------------------------------------------------------------------------

    def action_question(self, step: int) -> None:
        if self.session.next_question(step):
            self.view.give_keys(self.images[0])
        else:
            self.notify("The server asks nothing at present.", timeout=3)
        self.tick()

    def action_panel(self, number: int) -> None:
        """The keys go to a panel: map, matrix, list, or one of the two images."""
        self.view.give_keys(self.panels[number - 1])

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
        self.view.proposals.end()
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
        self.view.toggle_overview()

    def action_maximise(self) -> None:
        self.view.toggle_maximised()
