"""The screen of a recording: as the operator saw it, to watch and to look around in."""

import threading
from pathlib import Path

from textual.app import ComposeResult
from textual.binding import Binding
from textual.strip import Strip

from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.local_files import keymap_of
from fleetpose.hmi_client.recording.player import PlayClock, PlayedSession, Player
from fleetpose.hmi_client.tui.app import FleetApp
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import PanelMixin, line
from fleetpose.hmi_client.tui.run import own_screen
from fleetpose.hmi_client.tui.terminal.driver import PatientDriver
from fleetpose.protocol.recording.file import Recording

SKIP_S = 10.0


class PlayPanel(PanelMixin):
    """One line above all: where the recording stands."""

    def __init__(self, player: Player) -> None:
        super().__init__(id="play")
        self.player = player

    def paint(self) -> list[Strip]:
        player, width = self.player, self.extent.width
        ended = player.at_s >= player.seconds
        state = "ended" if ended else "paused" if player.paused else "playing"
        text = (
            f" {state:<8}{moment(player.at_s)} of {moment(player.seconds)}   "
            f", pause or go on   . {SKIP_S:.0f} s ahead   q quit "
        )
        shown = line(text, width, style("on why", "why", bold=True))
        done = int(width * player.at_s / max(player.seconds, 1e-9))
        head, tail = shown.divide([done, width]) if 0 < done < width else (shown, Strip.blank(0))
        return [Strip.join([head.apply_style(style("on step", "step", True)), tail])]


class ReplayApp(FleetApp):
    """The screen around a recorded session.

    Args:
        session: the recorded operator's.
        player: plays into it; it runs in a thread of its own.
        fps: how often the session is looked at.
        keymap: the keys of the commands.
    """

    BINDINGS = [  # noqa: RUF012, as Textual declares it
        Binding("comma", "pause", "Pause", id="pause"),
        Binding("full_stop", "skip", "Ahead", id="ahead"),
    ]

    def __init__(self, session: PlayedSession, player: Player, fps: float, keymap: KeyMap) -> None:
        self._stop = threading.Event()
        self._failed: Exception | None = None
        super().__init__({"recording": session}, fps, lambda: self._failed, PatientDriver, keymap)
        self.player = player
        self.play = PlayPanel(player)
        self._thread = threading.Thread(name="hmi play", target=self._run_player, daemon=True)

    def compose(self) -> ComposeResult:
        yield self.play
        yield from super().compose()

    def on_mount(self) -> None:
        super().on_mount()
        self._thread.start()

    def on_unmount(self) -> None:
        super().on_unmount()
        self._stop.set()
        self._thread.join(timeout=5.0)

    def tick(self) -> None:
        super().tick()
        self.play.repaint()

    def action_pause(self) -> None:
        self.player.toggle()
        self.tick()

    def action_skip(self) -> None:
        self.player.skip_to(self.player.at_s + SKIP_S)

    def _run_player(self) -> None:
        try:
            self.player.run(self._stop)
        except Exception as error:  # ends the app, which tells it
            self._failed = error


def run_replay(
    path: Path,
    speed: float,
    start_s: float,
    fps: float,
    threshold_m: float | None,
    log: Path | None,
    theme: palette.Choice = "auto",
    keys: Path | None = None,
) -> None:
    """Plays a recording on the screen until q.

    Raises:
        FleetPoseError: the file cannot be read, or is no recording of a session.
    """
    palette.use(palette.theme_for(theme))
    recording, clock = Recording(path), PlayClock(speed)
    session = PlayedSession(recording, clock, threshold_m)
    player = Player(recording, session, clock)
    player.skip_to(start_s)
    keymap = keymap_of(keys)
    with own_screen(log):
        app = ReplayApp(session, player, fps, keymap)
        palette.has(app.console.color_system)
        app.run()


def moment(seconds: float) -> str:
    """Minutes and seconds."""
    whole = int(seconds)
    return f"{whole // 60}:{whole % 60:02}"
