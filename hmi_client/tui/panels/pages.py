"""Pages of text over the panels: keys and signs, events, and why a robot is located or not."""

from collections.abc import Callable

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from fleetpose.hmi_client.cli.why import why_record, why_text
from fleetpose.hmi_client.desk.keymap import PLACES, KeyMap, of_place, printed
from fleetpose.hmi_client.desk.words import age_text, plain, signs
from fleetpose.hmi_client.model.session import OperatorSession

RENEWED_S = 0.5


class Page(ModalScreen[None]):
    """One text, renewed while it is shown.

    Args:
        heading: its title.
        text: makes it, for so many columns.
        step: called with -1 and 1 by left and right, for a page that has neighbours.
    """

    BINDINGS = [  # noqa: RUF012, as Textual declares it
        Binding("escape,c,q,question_mark,l,y", "dismiss", "Back"),
        Binding("left", "step(-1)", show=False),
        Binding("right", "step(1)", show=False),
    ]

    def __init__(
        self, heading: str, text: Callable[[int], str], step: Callable[[int], None] | None = None
    ) -> None:
        super().__init__()
        self._heading, self._text, self._step = heading, text, step
        self._body = Static(markup=False)

    def compose(self) -> ComposeResult:
        with VerticalScroll(id="page") as scroll:
            scroll.border_title = self._heading
            scroll.border_subtitle = "c goes back" + (", ← → another robot" if self._step else "")
            yield self._body

    def on_mount(self) -> None:
        self.call_after_refresh(self.renew)  # once it is known how wide the page is
        self.set_interval(RENEWED_S, self.renew)

    def renew(self) -> None:
        """Shows what is true now."""
        self._body.update(self._text(self._body.size.width or self.app.size.width))

    def action_step(self, step: int) -> None:
        if self._step is not None:
            self._step(step)
            self.renew()


def help_text(keymap: KeyMap) -> str:
    """All keys, by where they work, and what the signs mean."""
    parts = []
    for place in PLACES:
        lines = [
            f"  {' '.join(map(printed, keymap.keys(command))):<14}{command.label:<11}{command.does}"
            for command in of_place(place)
        ]
        parts.append("\n".join((place.capitalize(), *lines)))
    return "\n\n".join((*parts, signs(keymap.names())))


def events_text(session: OperatorSession) -> str:
    """What happened, the newest first."""
    told = [f"{age_text(age_s):>9}  {plain(text)}" for age_s, text in session.timed_events()]
    return "\n".join(told) or "nothing has happened yet"


class WhyPages:
    """Why each robot is located or not, one after the other.

    Args:
        session: what is known.
        robot: the first one.
    """

    def __init__(self, session: OperatorSession, robot: str) -> None:
        self._session, self._robot = session, robot

    def text(self, columns: int) -> str:
        """Of the present robot."""
        known = self._session.alignments(self._robot)
        return why_text(why_record(self._session, self._robot, known), columns)

    def step(self, step: int) -> None:
        """Turns to another robot."""
        robots = self._session.robots()
        self._robot = robots[(robots.index(self._robot) + step) % len(robots)]
