"""`hmi-client tutor` as a process: a lesson behind the ordinary client, then what came of it."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.local_files import state_folder
from fleetpose.hmi_client.tutor.advice import advice
from fleetpose.hmi_client.tutor.lesson import Lesson, Ready
from fleetpose.hmi_client.tutor.table import show

_LOOK_S = 0.2


@dataclass(frozen=True)
class Face:
    """The client that the learner works with.

    Attributes:
        command: of `hmi-client`: screen or web.
        options: of it.
    """

    command: str
    options: tuple[str, ...] = ()


def run_tutor(
    recording: Path | None, face: Face, apart: str, speed: float, report: Path | None
) -> None:
    """Runs a lesson until the learner leaves it or all robots are joined; prints what came of it.

    Args:
        recording: of a site; none: the built-in lesson.
        face: what the learner works with.
        apart: robots that the machine may not join: a,b.
        speed: of the recording, times as fast.
        report: a JSON file for what is printed, and more.

    Raises:
        OperatorError: the recording cannot be used, the lesson broke off, or the report cannot be
            written.
    """
    console = Console()
    with Lesson(recording, state_folder() / "tutor", apart, speed) as lesson:
        ready = _prepared(lesson)
        console.print(task(ready), highlight=False)
        _learn(lesson, ready, face)
        console.print("The last point does what it does ...", highlight=False)
        told = lesson.finish()
    show(told, console)
    if report is not None:
        write(told, report)


def task(ready: Ready) -> str:
    """What is to be done."""
    count = len(ready.robots)
    if not ready.apart:
        return f"{count} robots of a recording. What the machine does not join is yours."
    return (
        f"{count} robots; the machine may not join {', '.join(ready.apart)} to the others: click "
        "three points or more that are the same in both images. It ends when all are located, or "
        "when you leave."
    )


def _prepared(lesson: Lesson) -> Ready:
    """The lesson once it is made; a line of progress meanwhile."""
    shown = Console(stderr=True)
    with Progress(TextColumn("{task.description}"), BarColumn(), console=shown) as progress:
        making = progress.add_task("starting", total=None)

        def tell(done: int, of: int, what: str) -> None:
            progress.update(making, completed=done, total=of or None, description=what)

        return lesson.prepare(tell)


def _learn(lesson: Lesson, ready: Ready, face: Face) -> None:
    """Shows the face until it is left, or the lesson ends it."""
    connection = (*_each("--connect", ready.connect), "--site", ready.site)
    command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", face.command]
    with tempfile.TemporaryDirectory(prefix="fleetpose-learner-") as state:
        # clicks on their way, kept for a crash, are for this lesson alone
        environment = {**os.environ, "XDG_STATE_HOME": state}
        with subprocess.Popen([*command, *connection, *face.options], env=environment) as shown:
            try:
                while not (lesson.joined.is_set() or lesson.ended.is_set()):
                    try:
                        code = shown.wait(_LOOK_S)
                    except subprocess.TimeoutExpired:
                        continue
                    if code:
                        raise OperatorError(f"'hmi-client {face.command}' ended with {code}")
                    break
            except KeyboardInterrupt:  # how a page is left
                pass
            finally:  # asked, not killed: it gives the terminal back as it was
                shown.terminate()


def _each(option: str, values: Sequence[str]) -> list[str]:
    return [text for value in values for text in (option, value)]


def write(told: dict[str, Any], path: Path) -> None:
    """Writes a report, with the advice for each point.

    Raises:
        OperatorError: it cannot be written.
    """
    points = [{**point, "advice": advice(point)} for point in told["points"]]
    try:
        path.write_text(json.dumps({**told, "points": points}, indent=1) + "\n")
    except OSError as error:
        raise OperatorError(f"--report {path} cannot be written: {error.strerror}") from error
