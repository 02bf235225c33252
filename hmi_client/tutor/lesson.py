"""A lesson that runs in processes of its own: a router, a fresh server, robots of a recording.

They are the evaluation's, which alone knows the truth and stands above this package: it is started,
never imported. What passes are lines of JSON, see `Lesson`.
"""

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from fleetpose.hmi_client.errors import OperatorError

_END_S = 30.0  # for what the last point does, and for ending a fleet on a busy machine


@dataclass(frozen=True)
class Ready:
    """Where the lesson's fleet is.

    Attributes:
        connect: endpoints of its router.
        site: its name.
        robots: all of it.
        apart: those that the machine may not join to the others.
    """

    connect: tuple[str, ...]
    site: str
    robots: tuple[str, ...]
    apart: tuple[str, ...]


class Lesson:
    """Use it in a `with`, then `prepare`, look at `joined`, and `finish`.

    Args:
        recording: of a site; none: the built-in lesson.
        keep: folder of the built-in lesson and of the log.
        apart: robots that the machine may not join.
        speed: of the recording, times as fast.
    """

    def __init__(
        self, recording: Path | None, keep: Path, apart: str = "", speed: float = 1.0
    ) -> None:
        self._command = [sys.executable, "-P", "-m", "fleetpose.evaluation", "tutor"]
        self._command += ["--keep", str(keep), "--apart", apart, "--speed", str(speed)]
        self._command += [] if recording is None else ["--recording", str(recording)]
        self._log = keep / "tutor.log"
        self._told: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.joined = threading.Event()
        self.ended = threading.Event()

    def __enter__(self) -> Self:
        try:
            self._log.parent.mkdir(parents=True, exist_ok=True)
            log = self._log.open("wb")
        except OSError as error:
            raise OperatorError(f"{self._log} cannot be written: {error.strerror}") from error
        with log:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                process_group=0,  # Ctrl-C is for the client: the lesson is still to be reported
            )
        self._reader = threading.Thread(name="tutor", target=self._read, daemon=True)
        self._reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._leave()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait()

    def prepare(self, tell: Callable[[int, int, str], None]) -> Ready:
        """Waits until the learner may come.

        Args:
            tell: hears how far it is: steps done, steps in all, what is done now.

        Raises:
            OperatorError: the recording cannot be used, or something is missing.
        """
        while True:
            told = self._next()
            if "step" in told:
                step = told["step"]
                tell(step["done"], step["of"], step["what"])
            if "ready" in told:
                ready = told["ready"]
                names = {key: tuple(ready[key]) for key in ("connect", "robots", "apart")}
                return Ready(site=ready["site"], **names)

    def finish(self) -> dict[str, Any]:
        """Ends the lesson and returns its report.

        Raises:
            OperatorError: it had broken off.
        """
        self._leave()
        while "report" not in (told := self._next()):
            pass
        return told["report"]

    def _leave(self) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except BrokenPipeError:
            return  # it is gone, which shows when it is read

    def _next(self) -> dict[str, Any]:
        told = self._told.get()
        if "error" in told:
            raise OperatorError(told["error"])
        return told

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            if "joined" in told:
                self.joined.set()
            else:
                self._told.put(told)
        self._told.put({"error": self._last_words()})
        self.ended.set()

    def _last_words(self) -> str:
        """Why it ended, where it did not say."""
        lines = self._log.read_text(errors="replace").strip().splitlines()
        said = lines[-1] if lines else "it said nothing"
        return f"the lesson broke off: {said.removeprefix('pose-eval: ')}; all of it: {self._log}"
