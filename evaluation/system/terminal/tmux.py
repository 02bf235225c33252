"""A program in a real terminal: a window of a tmux server of our own."""

import itertools
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from fleetpose.protocol.errors import FleetPoseError

_TIMEOUT_S = 10.0


class Terminal:
    """A terminal with one program in it; use it in a `with`.

    Args:
        command: what runs in it.
        columns, rows: its size.
        environment: added to this process's.

    Raises:
        FleetPoseError: tmux is not installed.
    """

    def __init__(
        self,
        command: Sequence[str],
        columns: int = 160,
        rows: int = 50,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        if shutil.which("tmux") is None:
            raise FleetPoseError("tmux is not installed: it is the terminal for this measurement")
        self._command, self._size = command, (columns, rows)
        self._environment = environment or {}
        self.keys = 0
        self._screens = itertools.count(1)

    def __enter__(self) -> Self:
        self._folder = TemporaryDirectory(prefix="fleetpose-tmux-")
        self._socket = str(Path(self._folder.name) / "socket")
        columns, rows = self._size
        self._config = Path(self._folder.name) / "tmux.conf"
        self._config.write_text(
            f"set -g default-size {columns}x{rows}\nset -g status off\nset -g escape-time 0\n"
        )
        settings = [f"{name}={value}" for name, value in self._environment.items()]
        unset = ("-u", "COLUMNS", "-u", "LINES")  # they would overrule the terminal's own size
        line = shlex.join(["env", *unset, *settings, *self._command])
        self._tmux("new-session", "-d", "-x", str(columns), "-y", str(rows), "exec " + line)
        return self

    def __exit__(self, *_: object) -> None:
        subprocess.run(
            ["tmux", "-S", self._socket, "kill-server"], capture_output=True, check=False
        )
        self._folder.cleanup()

    @property
    def pid(self) -> int:
        """Of the program."""
        return int(self._tmux("display-message", "-p", "#{pane_pid}"))

    def press(self, *keys: str) -> None:
        """Presses keys, named as tmux does: `n`, `Tab`, `BTab`, `S-Left`, `Space`."""
        self.keys += len(keys)
        self._tmux("send-keys", *keys)

    def click(self, column: int, row: int) -> None:
        """Clicks into a cell, counted from 0, as a terminal reports it (SGR)."""
        place = f"0;{column + 1};{row + 1}"
        report = f"\x1b[<{place}M\x1b[<{place}m"
        self._tmux("send-keys", "-H", *(f"{byte:02x}" for byte in report.encode()))

    def resize(self, columns: int, rows: int) -> None:
        """Gives the terminal another size."""
        self._tmux("resize-window", "-x", str(columns), "-y", str(rows))

    def spoil(self, text: str) -> None:
        """Somebody else writes to the terminal."""
        Path(self._tmux("display-message", "-p", "#{pane_tty}").strip()).write_text(text)

    def screen(self, colours: bool = False) -> list[str]:
        """The lines that are shown; with their escape sequences if colours are wanted."""
        text = self._tmux("capture-pane", "-p", *(["-e"] if colours else []))
        return text.splitlines()

    def wait(
        self, condition: Callable[[list[str]], bool], what: str, timeout_s: float = _TIMEOUT_S
    ) -> list[str]:
        """The screen once a condition holds.

        Raises:
            FleetPoseError: it did not come true in time; the screen is in the text.
        """
        end = time.monotonic() + timeout_s
        while True:
            lines = self.screen()
            if condition(lines):
                return lines
            if time.monotonic() > end:
                shown = "\n".join(lines)
                raise FleetPoseError(f"after {timeout_s:g} s not on the screen: {what}\n{shown}")
            time.sleep(0.03)

    def wait_text(self, text: str, timeout_s: float = _TIMEOUT_S) -> list[str]:
        """The screen once a text is on it."""
        return self.wait(lambda lines: any(text in line for line in lines), text, timeout_s)

    def keep(self, folder: Path, name: str) -> None:
        """Writes what is shown to `<folder>/<number>-<name>.txt`."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{next(self._screens):02d}-{name}.txt"
        path.write_text("\n".join(self.screen()) + "\n")

    def _tmux(self, *arguments: str) -> str:
        done = subprocess.run(
            ["tmux", "-S", self._socket, "-f", str(self._config), *arguments],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            raise FleetPoseError(f"tmux {arguments[0]}: {done.stderr.strip() or 'failed'}")
        return done.stdout
