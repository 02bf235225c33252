"""What pages of one operator sit at: a desk, be it of a live session or of a recorded one."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.network.client import Client
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.hmi_client.recording.player import PlayClock, PlayedSession, Player
from fleetpose.protocol.messages import View, ViewName
from fleetpose.protocol.recording.file import Recording


class Seat(Protocol):
    """A desk and what feeds its session."""

    replay: bool

    @property
    def desk(self) -> Desk:
        """The desk; another one after a recording was played anew."""
        ...

    @property
    def failure(self) -> Exception | None:
        """A bug that ended what feeds the session."""
        ...

    def fetch_view(self, view: ViewName) -> View:
        """A view of a robot without its image.

        Raises:
            FleetPoseError: nobody has it, or it is damaged.
        """
        ...

    def play(self, do: str, args: dict[str, Any]) -> None:
        """Carries a command of a recording out."""
        ...

    def clock(self) -> dict[str, Any] | None:
        """Where a recording stands, as a frame; none of a live session."""
        ...

    def close(self) -> None:
        """Ends what feeds the session."""
        ...


class LiveSeat:
    """A desk over a client; `kept` is the file of updates on their way."""

    replay = False

    def __init__(self, desk: Desk, client: Client, kept: UpdateLog | None) -> None:
        self.desk, self._client, self._kept = desk, client, kept
        client.start_in_background()

    @property
    def failure(self) -> Exception | None:
        return self._client.failure

    def fetch_view(self, view: ViewName) -> View:
        return self._client.fetch_view(view)

    def play(self, do: str, args: dict[str, Any]) -> None:
        """Nothing: what is live goes at its own pace."""

    def clock(self) -> dict[str, Any] | None:
        return None

    def close(self) -> None:
        self._client.close()
        if self._kept is not None:
            self._kept.close()


class PlayedSeat:
    """A desk over a recording. Going back plays it anew from its beginning.

    Args:
        path: the file.
        desk_of: makes a desk for a session.

    Raises:
        FleetPoseError: the file cannot be read, or is no recording of a session.
    """

    replay = True

    def __init__(self, path: Path, desk_of: Callable[[PlayedSession], Desk]) -> None:
        self._path, self._desk_of = path, desk_of
        self.failure: Exception | None = None
        self._speed, self._stop = 1.0, threading.Event()
        self._begin(0.0, paused=False)

    def play(self, do: str, args: dict[str, Any]) -> None:
        if do == "play":
            if self._player.paused != args.get("paused", not self._player.paused):
                self._player.toggle()
        elif do == "speed":
            self._speed = min(max(float(args.get("value", 1.0)), 0.05), 100.0)
            self._clock.set(self._clock(), self._clock.paused)
            self._clock.speed = self._speed
        elif do == "seek":
            self._seek(min(max(float(args.get("s", 0.0)), 0.0), self._player.seconds))

    def clock(self) -> dict[str, Any] | None:
        player = self._player
        return {
            "t": "clock",
            "s": round(player.at_s, 1),
            "of_s": round(player.seconds, 1),
            "paused": player.paused,
            "speed": self._speed,
        }

    def fetch_view(self, view: ViewName) -> View:
        raise NotImplementedError("a recording is asked for nothing")

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5.0)
        self.desk.close()

    @property
    def name(self) -> tuple[str, str]:
        """Site and operator of the recording."""
        return self._recording.site, self._recording.operator

    def _seek(self, at_s: float) -> None:
        if at_s >= self._player.at_s and self._thread.is_alive():
            self._player.skip_to(at_s)
            return
        paused = self._player.paused and self._thread.is_alive()
        self.close()
        self._begin(at_s, paused)

    def _begin(self, at_s: float, paused: bool) -> None:
        self._stop, self._clock = threading.Event(), PlayClock(self._speed)
        self._recording = Recording(self._path)
        session = PlayedSession(self._recording, self._clock)
        self.desk = self._desk_of(session)
        self._player = player = Player(self._recording, session, self._clock)
        player.skip_to(at_s)
        stop = self._stop
        self._thread = threading.Thread(
            name="web play", target=lambda: self._run(player, stop, paused), daemon=True
        )
        self._thread.start()

    def _run(self, player: Player, stop: threading.Event, paused: bool) -> None:
        try:
            player.run(stop, paused)
        except Exception as error:  # a bug, or the file is gone: told where the pages are served
            self.failure = error
