"""The text client: the panels of one site or of several. It reads the sessions at its own rate."""

import asyncio
import signal
import time
from collections.abc import Callable, Mapping

from textual.app import App, ComposeResult
from textual.driver import Driver

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.keymap import KeyMap, of_place
from fleetpose.hmi_client.desk.words import farewell
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.panels.footer import KeyLine
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

_PANELS = ("panel-map", "panel-matrix", "panel-list", "panel-left", "panel-right")
_SITE_STEPS = {"site": 1, "site-before": -1}


class FleetApp(App[None]):
    """Shows one site of an operator's; all keys and clicks are for the one that is shown.

    Args:
        sites: the operator's session at each site, by its name; the first is shown first.
        fps: how often the sessions are looked at.
        failure: tells a bug of a connection, which ends the app.
        keymap: the keys of the commands.
        where: how sentences call each site and its server.
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
        keymap: KeyMap = KeyMap(),  # noqa: B008, it cannot be changed
        where: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(driver_class=driver)
        self.keymap = keymap
        self._period_s = 1.0 / fps
        self._failure = failure
        names = keymap.names()
        told = where or {}
        self.views = {
            name: SiteView(name, Desk(session, names, told.get(name, "")))
            for name, session in sites.items()
        }
        self.view = next(iter(self.views.values()))
        self.sites = SitesPanel(sites, self.view.site, names)
        self.keys = KeyLine(keymap, len(sites) > 1, lambda command: self._press(command.id))

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
        yield self.keys

    def on_mount(self) -> None:
        self.set_keymap(bindings.changed_keys(self.keymap))
        self.view.give_keys(self.matrix)
        self.set_interval(self._period_s, self.tick)
        if not self.is_headless:  # whoever ends the process gets the terminal back as it was
            for ending in (signal.SIGTERM, signal.SIGHUP):
                asyncio.get_running_loop().add_signal_handler(ending, self.exit)

    def on_unmount(self) -> None:
        for view in self.views.values():
            view.desk.close()

    def farewell(self) -> tuple[str, ...]:
        """A line per site of what was done there."""
        desks = {site: view.desk for site, view in self.views.items()}
        lines = {site: farewell(desk.session, desk.done) for site, desk in desks.items()}
        several = len(lines) > 1
        return tuple(f"{site}: {text}" if several else text for site, text in lines.items())

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
            self.keys.place = self.view.place
            self.keys.repaint()
            if len(self.views) > 1:
                self.sites.repaint()

    # ---- sites -----------------------------------------------------------------------------------

    def action_site(self, step: int) -> None:
        """Shows the next site (-1: the one before)."""
        names = list(self.views)
        if len(names) > 1:
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

    def action_do(self, command: str) -> None:
        """A command by its key: of the whole screen, or done at the desk of the site shown."""
        if command.startswith("panel-"):
            self.view.give_keys(self.panels[_PANELS.index(command)])
        elif command in _SITE_STEPS:
            self.action_site(_SITE_STEPS[command])
        elif command == "redraw":
            self.action_redraw()
        else:
            self.view.do(command, **self._meant(command))
            self._turn_page()
        self.tick()

    def _press(self, command: str) -> None:
        """A command that was clicked: as its key, for the panel that has the keys."""
        panel = self.focused
        place = {c.id for c in of_place(self.view.place)}
        if command in place and isinstance(panel, PanelMixin):
            panel.action_do(command)
        else:
            self.action_do(command)

    def _meant(self, command: str) -> dict[str, object]:
        """What a command is for: the list's entry, the image at work, the robot in the matrix."""
        if command == "erase" and not isinstance(self.focused, ImagePanel):
            entry = self.list.current()
            return {"id": -1 if entry is None or entry.id is None else entry.id}
        if command == "why" and self.session.pair is None and self.session.robots():
            robots = self.session.robots()
            return {"robot": robots[min(self.matrix.cursor[0], len(robots) - 1)]}
        return {}

    def _turn_page(self) -> None:
        """Shows the page that the desk has opened, or ends."""
        desk = self.view.desk
        page, desk.page = desk.page, ""
        match page:
            case "help":
                self.push_screen(Page("keys and signs", lambda _: help_text(self.keymap)))
            case "events":
                told = Page("events, the newest first", lambda _: events_text(self.session))
                self.push_screen(told)
            case "why":
                pages = WhyPages(self.session, desk.about)
                self.push_screen(Page("why is it located, or not", pages.text, pages.step))
        if desk.left:
            self.exit()
