"""Running the text client: on a terminal, or without one for a picture of it."""

import asyncio
import ctypes
import gc
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr
from pathlib import Path

from fleetpose.hmi_client.cli.connection import DEFAULT_SITE, Connection
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.local_files import default_log, keymap_of, own_log, own_updates
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.hmi_client.network.shared import SharedLink
from fleetpose.hmi_client.tui.app import FleetApp
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.terminal.driver import PatientDriver
from fleetpose.protocol.recording.file import Recorder

_M_ARENA_MAX = -8  # of glibc's malloc.h

RETRY_TIMEOUT_S = 2.0  # per attempt to reach the router; the screen is there meanwhile


def run_screen(
    sites: tuple[Connection, ...],
    fps: float,
    threshold_m: float | None,
    log: Path | None,
    theme: palette.Choice = "auto",
    keys: Path | None = None,
    record: Path | None = None,
) -> None:
    """Runs the app until the operator quits; it also starts without a router and waits for one.

    Args:
        sites: the fleets of the operator; the first is shown first.
        fps: how often the session is looked at.
        threshold_m: errors above it are hidden; default: a share of the scene's depth.
        log: the log file; default: in the state folder.
        theme: the colours.
        keys: a file of keys; default: that in the user's config folder, if there is one.
        record: a file that all messages of the first site are recorded in.

    Raises:
        FleetPoseError: the log or the recording cannot be written, or the keys are not right.
    """
    palette.use(palette.theme_for(theme))
    keymap = keymap_of(keys)
    _spare()
    with ExitStack() as closing:
        closing.enter_context(own_screen(log))
        recorder = None
        if record is not None:
            recorder = Recorder(record, sites[0].site, sites[0].operator, "hmi-client")
            closing.callback(recorder.close)
        shared = SharedLink(lambda: sites[0].open_link(RETRY_TIMEOUT_S))
        clients = {
            where.site: _started(where, closing, threshold_m, recorder, shared) for where in sites
        }
        app = FleetApp(
            {site: client.session for site, client in clients.items()},
            fps,
            lambda: next((c.failure for c in clients.values() if c.failure), None),
            PatientDriver,
            keymap,
            {w.site: f"of {w.site} at {', '.join(w.connect)}" for w in sites},
        )
        palette.has(app.console.color_system)
        app.run()
    print("\n".join(app.farewell()))
    if recorder is not None:
        print(recorder.report())


def _started(
    where: Connection,
    closing: ExitStack,
    threshold_m: float | None,
    recorder: Recorder | None,
    shared: SharedLink,
) -> Client:
    """The client of a site, which connects as soon as there is a router."""
    kept = own_updates(where)
    if kept is not None:
        closing.callback(kept.close)
    session = where.session(threshold_m, kept)
    # the map is painted twice a second: poses as fast as they come would be opened in vain
    client = where.client(session, RETRY_TIMEOUT_S, recorder, each_pose=False, shared=shared)
    closing.callback(client.close)
    client.start_in_background()
    return client


def _spare() -> None:
    """Painting makes garbage by the tens of thousands a second, next to none of it in cycles: the
    collector looks rarely, and never at what is there from the start. glibc gives each thread a
    heap of its own; one for all takes less memory.
    """
    gc.freeze()
    gc.set_threshold(50_000, 10, 100)
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_ARENA_MAX, 1)


@contextmanager
def own_screen(log: Path | None) -> Iterator[None]:
    """The terminal is the screen's alone; what else is said goes to the log (default: in the state
    folder).
    """
    log = log or default_log()
    own_log(log)
    with own_stderr(log):
        yield


def take_screenshot(
    where: Connection,
    out: Path,
    size: tuple[int, int],
    timeout_s: float,
    pair: str,
    maximise: bool,
    threshold_m: float | None,
) -> bool:
    """Writes an SVG of the screen; whether poses and both images had arrived by then.

    Raises:
        NoServerError: no server was heard.
        OperatorError: the pair is no pair of known robots.
    """
    robots = pair.split(",") if pair else []
    if len(robots) not in (0, 2):
        raise OperatorError(f"'{pair}' is no pair: write R1,R2")
    with where.server() as session:
        if threshold_m is not None:
            session.set_threshold(threshold_m)
        if robots:
            session.select(robots[0], robots[1])
        else:
            session.next_question()
        svg, complete = asyncio.run(_draw(session, size, timeout_s, maximise))
    try:
        out.write_text(svg, encoding="utf-8")
    except OSError as error:
        raise OperatorError(f"{out} cannot be written: {error.strerror}") from error
    return complete


async def _draw(
    session: OperatorSession, size: tuple[int, int], timeout_s: float, maximise: bool
) -> tuple[str, bool]:
    app = FleetApp({DEFAULT_SITE: session})
    end = time.monotonic() + timeout_s
    async with app.run_test(size=size) as pilot:
        await pilot.pause(0.1)
        if session.pair is not None:
            app.view.give_keys(app.images[0])
        if maximise:
            app.view.do("maximise")
        while not is_complete(session) and time.monotonic() < end:
            await pilot.pause(0.1)
        for panel in app.panels:
            panel.repaint()
        await pilot.pause(0.3)
        return app.export_screenshot(title="fleetpose"), is_complete(session)


def is_complete(session: OperatorSession) -> bool:
    """Whether poses and, with a pair selected, both images are there."""
    images = all(session.picture(robot) is not None for robot in session.pair or ())
    return bool(session.poses()) and images


@contextmanager
def own_stderr(log: Path) -> Iterator[None]:
    """Keeps stderr for the screen, which is drawn there: what libraries in C write to descriptor 2
    themselves, such as the JPEG decoder's complaints, goes to the log.
    """
    before, real = sys.__stderr__, os.dup(2)
    with log.open("ab") as file, os.fdopen(real, "w", encoding="utf-8") as screen:
        os.dup2(file.fileno(), 2)
        sys.__dict__["__stderr__"] = screen
        try:
            with redirect_stderr(screen):
                yield
        finally:
            screen.flush()
            sys.__dict__["__stderr__"] = before
            os.dup2(real, 2)
