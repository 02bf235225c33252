"""The whole screen in every state, as text; `pytest --snapshot-update` writes them anew."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from hmi_fakes import EPOCH, fleet, view
from screen_makers import Clock, press, screen, selected
from syrupy.extensions.single_file import SingleFileSnapshotExtension, WriteMode

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import (
    Correspondence,
    PairCorrespondences,
    Question,
    Receipts,
    Rejection,
    Suggestion,
)

A, B = (100.0, 50.0), (110.0, 60.0)


class ScreenText(SingleFileSnapshotExtension):
    """A screen per file, to be read as it is."""

    _write_mode = WriteMode.TEXT
    file_extension = "txt"


@pytest.fixture
def screens(snapshot):
    return snapshot.use_extension(ScreenText)


@dataclass(frozen=True)
class State:
    """What the session knows, what is then pressed, and the size of the terminal."""

    robots: int | None = 6
    keys: tuple[str, ...] = ()
    change: Callable[[OperatorSession, Clock], None] = lambda *_: None
    images: bool = False
    size: tuple[int, int] = (160, 50)


def clicked(status, **changes):
    item = Correspondence(
        id=4,
        operator="bob",
        view_i=view("r1"),
        view_j=view("r2"),
        pixel_i=A,
        pixel_j=B,
        status=status,
        residual_m=0.34,
        residual_px=21.0,
        **changes,
    )
    return PairCorrespondences(i="r1", j="r2", revision=1, items=(item,), server_epoch=EPOCH)


def outlier(session, _):
    session.on_correspondences(clicked("outlier"))


def rejected(session, _):
    session.add(view("r1"), A, view("r2"), B)
    rejection = Rejection(n=1, reason="the pixel has no depth")
    mine = {"operator": session.operator, "session": session.selection().session}
    session.on_receipts(Receipts(**mine, n=1, rejections=(rejection,), server_epoch=EPOCH))


def unconfirmed(session, _):
    session.add(view("r1"), A, view("r2"), B)


def silent(session, clock):
    unconfirmed(session, clock)
    clock.now += 9.0


def suggested(session, _):
    points = (Suggestion(pixel_i=A, pixel_j=B), Suggestion(pixel_i=B, pixel_j=A))
    views = {"view_i": view("r1"), "view_j": view("r2")}
    question = Question(i="r1", j="r2", **views, reason="weak", gain=0.1, suggestions=points)
    session.on_fleet(fleet(6, n=2, questions=(question,)))


def doubted(session, _):
    """Each pair more doubtful than the one before; of the first two poses fit."""
    first, *others = (
        cell.model_copy(update={"p_grave": 0.5 / 2**k}) if cell.rmse_m is not None else cell
        for k, cell in enumerate(fleet(6).pairs)
    )
    ambiguous = first.model_copy(update={"verdict": "ambiguous", "rivals": 1})
    session.on_fleet(fleet(6, n=2, pairs=(ambiguous, *others)))
    session.select("r1", "r2")


def unreadable(session, _):
    session.on_unreadable("r1", "these bytes are no JPEG", view("r1"))


STATES = {
    "no-server-heard": State(None),
    "no-robots": State(0),
    "one-robot": State(1),
    "fleet": State(),
    "72-robots": State(72),
    "72-robots-overview": State(72, keys=("o", "down", "down")),
    "waiting-for-images": State(keys=("n",)),
    "pair": State(images=True),
    "half-picked": State(images=True, keys=("space",)),
    "not-confirmed": State(images=True, change=unconfirmed),
    "lost-server": State(images=True, change=silent),
    "rejected": State(images=True, change=rejected),
    "outlier": State(images=True, change=outlier),
    "suggestion": State(images=True, change=suggested, keys=("tab",)),
    "unreadable-image": State(images=True, change=unreadable),
    "maximised": State(images=True, keys=("m",)),
    "overlap-in-the-matrix": State(keys=("t",) * 3),
    "doubt-in-the-matrix": State(change=doubted, keys=("t",) * 6),
    "help": State(keys=("question_mark",)),
    "events": State(keys=("l",)),
    "why": State(images=True, keys=("y",)),
    "narrow": State(images=True, change=outlier, size=(100, 30)),
    "narrow-all-panels": State(images=True, change=outlier, keys=("m",), size=(100, 30)),
    "tiny": State(images=True, size=(60, 20)),
}


def shown(app) -> str:
    """The screen without the footer, which Textual composes in its own time."""
    strips = app.screen._compositor.render_strips()[:-1]
    lines = [strip.text.replace("\u00a0", " ").rstrip() for strip in strips]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("name", STATES)
async def test_the_screen_is_as_it_was(name, screens, clock):
    state = STATES[name]
    session = OperatorSession("anna", session="abcdefabcdef", clock=clock)
    if state.robots is not None:
        session.on_fleet(fleet(state.robots))
    async with screen(session, state.size) as (app, pilot):
        if state.images:
            await selected(session, pilot)
        state.change(session, clock)
        await press(pilot, *state.keys)
        for _ in range(3):
            for panel in app.panels:
                panel.repaint()
            app.tick()
            await pilot.pause()
        assert shown(app) == screens


def test_every_state_is_another_screen():
    folder = Path(__file__).parent / "__snapshots__" / "test_snapshots"
    texts = {file.name: file.read_text() for file in folder.glob("*.txt")}
    assert len(texts) == len(STATES) == len(set(texts.values()))
