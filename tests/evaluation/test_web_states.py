"""`pose-eval web`: what its bars of states, picks and the gate stand on. The bars themselves need a
fleet and a browser; they are run by the command.
"""

import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")

from fleetpose.evaluation.system.web.nonsense import frames_of_nonsense
from fleetpose.evaluation.system.web.pointers import Pointer
from fleetpose.evaluation.system.web.states.audit import Said
from fleetpose.hmi_client.web.heard import LONGEST, MalformedError, parse


def test_nonsense_is_malformed_and_short_enough_to_be_counted():
    frames = frames_of_nonsense(3000)
    assert {type(frame) for frame in frames} == {str, bytes} and len(set(frames)) > 1000
    for frame in frames:
        text = frame if isinstance(frame, str) else ""
        assert len(text.encode("utf-8", "surrogatepass")) < LONGEST
        with pytest.raises(MalformedError):
            parse(text)


def test_a_word_that_differs_between_page_and_terminal_is_found():
    facts = ("1 of 3 points", "asked: nothing joins r2", "they may overlap", "r3 is near")
    shown = ("1 of 3 points", "asked: Nothing joins r2", "They may overlap")
    assert Said("Pick it", facts, "Pick it", shown).alike
    assert not Said("Pick it", facts, "Pick it", (*shown[:2], "They overlap")).alike
    assert not Said("Pick it", facts, "Pick it", shown[:2]).alike
    assert not Said("Pick it", facts, "All are located", shown).alike
    assert Said("Pick it", facts, "All are located", ("What to do: Pick it",)).alike


class _Page:
    """Keeps what its browser is told."""

    def __init__(self) -> None:
        self.told: list[dict] = []
        self.context = self

    def new_cdp_session(self, page: object) -> "_Page":
        return self

    def send(self, method: str, told: dict) -> None:
        self.told.append(told)


def test_a_pointer_tells_whole_pixels_of_the_screen_only():
    page = _Page()
    Pointer(page, "pen", 1.25).click(10.3, 20.7)
    assert {(one["x"], one["y"]) for one in page.told} == {(10.4, 20.8)}
    assert {one["pointerType"] for one in page.told} == {"pen"}
    page.told.clear()
    Pointer(page, "touch", 1.0).drag(100, 100, 30.4, 0)
    assert [one["touchPoints"] for one in page.told[-2:]] == [[{"x": 130, "y": 100}], []]
