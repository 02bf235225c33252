"""Pages of text over the panels: keys and signs, events, and why a robot is located or not."""

from collections.abc import Callable

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from fleetpose.hmi_client.cli.why import why_record, why_text
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.bindings import PLACES, KeyMap, printed

RENEWED_S = 0.5
SIGNS = """
Matrix   1.2   error of the pair, root mean square          bold  the largest of all
         -     above the threshold, or rejected; {hide} and {show} move it
         ~     known only through others                    ·     never tried
         •     points were clicked in this pair               ◂     another operator is there
Map      ● located   ○ not   ─ heading   ⠒ two sigma        apart: not joined to the anchor
Image    1 a point that was clicked   1! contradicts the solution   x rejected or being erased
         ◆ the half that was picked   ◇ where the other half is expected
""".strip("\n")


class Page(ModalScreen[None]):
    """One text, renewed while it is shown.

    Args:
        heading: its title.
        text: makes it.
        step: called with -1 and 1 by left and right, for a page that has neighbours.
    """

    BINDINGS = [  # noqa: RUF012, as Textual declares it
        Binding("escape,c,q,question_mark,l,y", "dismiss", "Back"),
        Binding("left", "step(-1)", show=False),
        Binding("right", "step(1)", show=False),
    ]

    def __init__(
        self, heading: str, text: Callable[[], str], step: Callable[[int], None] | None = None
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
        self.renew()
        self.set_interval(RENEWED_S, self.renew)

    def renew(self) -> None:
        """Shows what is true now."""
        self._body.update(self._text())

    def action_step(self, step: int) -> None:
        if self._step is not None:
            self._step(step)
            self.renew()


def help_text(keymap: KeyMap) -> str:
    """All keys, by where they work, and what the signs mean."""
    parts = []
    for where, bindings in PLACES.items():
        lines = []
        for b in bindings:
            if b.description:
                keys = " ".join(map(printed, keymap.keys(b).split(",")))
                lines.append(f"  {keys:<14}{b.description:<11}{b.tooltip}")
        parts.append("\n".join((where, *lines)))
    names = keymap.names()
    signs = SIGNS.format(hide=names["hide-more"], show=names["show-more"])
    return "\n\n".join((*parts, signs))


def events_text(session: OperatorSession) -> str:
    """What happened, the newest first."""
    return "\n".join(reversed(session.events)) or "nothing has happened yet"


class WhyPages:
    """Why each robot is located or not, one after the other.

    Args:
        session: what is known.
        robot: the first one.
    """

    def __init__(self, session: OperatorSession, robot: str) -> None:
        self._session, self._robot = session, robot

    def text(self) -> str:
        """Of the present robot."""
        known = self._session.alignments(self._robot)
        return why_text(why_record(self._session, self._robot, known))

    def step(self, step: int) -> None:
        """Turns to another robot."""
        robots = self._session.robots()
        self._robot = robots[(robots.index(self._robot) + step) % len(robots)]
