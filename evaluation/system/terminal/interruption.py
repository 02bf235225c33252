"""The server is killed while the operator is in the middle of a click, and comes back later."""

from dataclasses import dataclass
from pathlib import Path

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.system.terminal.tmux import Terminal

SAID_WITHIN_S = 10.0
BACK_WITHIN_S = 40.0
POINT = 2  # of which the first half is picked before, the second without a server


@dataclass
class Interruption:
    """Kills the server between the halves of one point.

    Attributes:
        silence_said: the screen said that no server is heard.
        unconfirmed_said: the screen said how many points are not confirmed.
        confirmed_said: the screen said, after the server had come back, that all are.
    """

    fleet: LocalFleet
    terminal: Terminal
    screens: Path
    silence_said: bool = False
    unconfirmed_said: bool = False
    confirmed_said: bool = False

    def half(self, number: int) -> None:
        """The first half of a point has been picked."""
        if number == POINT:
            self.terminal.wait_text(f"{POINT - 1} point confirmed", SAID_WITHIN_S)
            self.fleet.kill("server")
            self.silence_said = bool(self.terminal.wait_text("NO SERVER", SAID_WITHIN_S))
            self.terminal.keep(self.screens, "server-killed")

    def whole(self, number: int) -> None:
        """A point has been picked."""
        if number == POINT:
            self.unconfirmed_said = bool(
                self.terminal.wait_text("1 not confirmed yet", SAID_WITHIN_S)
            )
            self.terminal.keep(self.screens, "not-confirmed")
            self.fleet.restart("server")
            self.confirmed_said = bool(
                self.terminal.wait_text(f"{POINT} points confirmed", BACK_WITHIN_S)
            )
            self.terminal.keep(self.screens, "confirmed-after-all")

    def said(self) -> dict[str, bool]:
        """For the summary."""
        return {
            "silence_said": self.silence_said,
            "unconfirmed_said": self.unconfirmed_said,
            "confirmed_said": self.confirmed_said,
        }
