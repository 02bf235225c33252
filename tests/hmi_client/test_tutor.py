"""What a learner is told at the end of a lesson."""

import io
import json

import pytest
from rich.console import Console

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.tutor.advice import advice, is_bad
from fleetpose.hmi_client.tutor.lesson import Lesson, Ready
from fleetpose.hmi_client.tutor.run import task, write
from fleetpose.hmi_client.tutor.table import ending, row, show

STANDING = {
    "located": 3,
    "fleet_error_m": 0.004,
    "pair_error_m": None,
    "pair_error_deg": None,
    "sigma_m": None,
}
JOINED = {**STANDING, "located": 5, "pair_error_m": 0.012, "sigma_m": 0.021}


def point(**told):
    usual = {
        "n": 1,
        "moved": False,
        "i": "r3",
        "j": "r4",
        "pixel_i": [10.0, 20.0],
        "pixel_j": [30.0, 40.0],
        "fits": [31.0, 40.0],
        "off_px": 1.0,
        "off_m": 0.014,
        "why": "",
        "alike": 0.99,
        "px_m": 0.014,
        "steps": 0,
        "taken": "accepted",
        "reason": "",
        "residual_m": 0.02,
        "before": STANDING,
        "after": JOINED,
    }
    return {**usual, **told}


def report(*points):
    return {
        "recording": "lesson-1.mcap",
        "against": "the true poses and depths",
        "robots": ["r1", "r2", "r3", "r4", "r5"],
        "apart": ["r4", "r5"],
        "before": STANDING,
        "after": JOINED,
        "points": list(points),
    }


def test_a_good_point_is_told_with_what_it_did_and_needs_no_advice():
    assert not is_bad(point()) and advice(point()) == ""
    cells = row(point())
    assert cells[:5] == ("1", "r3 r4", "1.0", "1.4 cm", "accepted")
    assert cells[5:] == ("3 > 5", "- > 1.2 cm", "0.4 cm > 0.4 cm", "- > 2.1 cm")


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"off_px": 220.0, "off_m": 3.14, "steps": -1}, "3.1 m off: the same pattern one step"),
        ({"off_px": 440.0, "off_m": 6.28, "steps": 2}, "pattern 2 steps further"),
        ({"off_px": 90.0, "off_m": 1.2, "alike": 0.8}, "the right place looks nearly the same"),
        ({"off_px": 90.0, "off_m": 1.2, "alike": 0.1}, "do not look alike"),
        ({"off_px": 8.0, "off_m": 0.11, "alike": 0.4}, "let s snap to the corner"),
        ({"off_px": 3.0, "off_m": 1.5, "alike": 0.4}, "1.5 m in depth: it is beside an edge"),
        ({"off_px": None, "fits": None, "why": "outside", "px_m": None}, "r4's image does not"),
        ({"why": "hidden"}, "something stands before"),
    ],
)
def test_a_bad_point_gets_one_sentence_from_what_was_measured(told, said):
    bad = point(**told)
    assert is_bad(bad)
    assert said in advice(bad)


def test_what_could_not_be_measured_is_said_and_not_blamed():
    for why, said in (("no pose", "not known"), ("no depth", "no")):
        unknown = point(why=why, off_px=None, off_m=None, fits=None, px_m=None, alike=None)
        assert not is_bad(unknown) and said in advice(unknown)


def test_the_table_names_what_points_are_held_against_and_how_it_ended():
    console = Console(width=140, record=True, file=io.StringIO())
    bad = point(n=2, off_px=220.0, off_m=3.14, steps=1, taken="refused", reason="no depth here")
    show(report(point(), bad), console)
    text = console.export_text()
    assert "Against the true poses and depths" in text and "220.0" in text
    assert "2: refused: no depth here 3.1 m off" in text
    assert "1 of 2 points were good. 5 of 5 robots are located, 0.4 cm off" in text


def test_who_clicked_nothing_is_told_how_to_get_work():
    assert "--apart" in ending(report())
    assert "--apart" not in ending({**report(), "after": STANDING})


def test_the_report_is_written_with_its_advice_or_says_why_not(tmp_path):
    path = tmp_path / "report.json"
    write(report(point(), point(off_px=50.0, alike=0.0)), path)
    good, bad = json.loads(path.read_text())["points"]
    assert good["advice"] == "" and "50 px off" in bad["advice"]
    with pytest.raises(OperatorError, match="cannot be written"):
        write(report(), tmp_path / "absent" / "report.json")


def test_the_task_names_who_is_apart():
    ready = Ready(("tcp/127.0.0.1:1",), "tutor", ("r1", "r2"), ("r2",))
    assert "may not join r2" in task(ready)
    assert "What the machine does not join is yours" in task(Ready((), "tutor", ("r1", "r2"), ()))


def test_a_recording_that_is_none_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "none.mcap").write_bytes(b"nothing")
    with (
        Lesson(tmp_path / "none.mcap", tmp_path) as lesson,
        pytest.raises(OperatorError, match="is no recording of 'pose-server record'"),
    ):
        lesson.prepare(lambda *_: None)
