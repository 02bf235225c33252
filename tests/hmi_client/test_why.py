"""What `hmi-client why` makes of the server's alarms."""

from hmi_fakes import alignment, fleet

from fleetpose.hmi_client.cli.reports import Watcher, sentence, status_text
from fleetpose.hmi_client.cli.why import why_record, why_text
from fleetpose.hmi_client.desk.words import describe_cell
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import Alarm, PairCell

TEXT = "r6's depths are 5.1 +- 0.4 % too long against 4 partners: check its baseline"


def test_why_shows_a_suspect_calibration_and_asks_for_no_clicks():
    session = OperatorSession("op")
    session.on_fleet(fleet(6, alarms=(Alarm(robot="r6", kind="scale", text=TEXT),)))
    record = why_record(session, "r6", {})
    assert record["alarms"] == [TEXT]
    assert record["next"].startswith("do what its alarm says")
    assert f"alarm: {TEXT}" in why_text(record).splitlines()
    other = why_record(session, "r5", {})
    assert other["alarms"] == [] and "calibration" not in why_text(other)


def in_doubt(*cells):
    """A session whose pairs are these."""
    session = OperatorSession("op", clock=lambda: 0.0)
    session.on_fleet(fleet(4, pairs=cells))
    return session


PLAUSIBLE = PairCell(
    i="r1", j="r2", state="tried", verdict="plausible", rmse_m=0.03, overlap=0.5, age_s=7.0
)
DOUBTED = PLAUSIBLE.model_copy(update={"p_grave": 0.12})
TWOFOLD = DOUBTED.model_copy(
    update={"verdict": "ambiguous", "p_grave": 0.5, "rivals": 1, "j": "r3"}
)
FAILED = PairCell(i="r2", j="r3", state="tried", verdict="rejected", age_s=2.0)


def test_every_command_says_how_likely_a_pair_is_gravely_off_and_how_many_poses_fit():
    session = in_doubt(DOUBTED, TWOFOLD, FAILED)
    words = "plausible, 12 % likely to be gravely off"
    twofold = "ambiguous: 2 poses fit, 50 % likely to be gravely off"
    told = why_text(why_record(session, "r1", {}))
    assert words in told and twofold in told
    watched = [sentence(one) for one in Watcher(session).news() if one["type"] == "pair"]
    assert f"pair  r1 - r2  3.0 cm  {words}  0 clicked" in watched
    assert "pair  r2 - r3  -  rejected  0 clicked" in watched
    doubtful = [line for line in status_text(session).splitlines() if "likely to be grave" in line]
    assert [line.split("  ")[0] for line in doubtful] == ["r1 - r3", "r1 - r2"]
    session.select("r1", "r3")
    assert describe_cell(session).startswith(twofold)


def test_a_pair_whose_last_try_failed_shows_a_hyphen_with_the_age_of_that_try():
    session = in_doubt(FAILED)
    why = alignment("r2", "r3", reasons=("3 matches, need 6",))
    row = next(
        line
        for line in why_text(why_record(session, "r2", {("r2", "r3"): why})).splitlines()
        if line.startswith("r3")
    )
    assert row.split()[:6] == ["r3", "rejected", "-", "2", "s", "ago"]
    assert "only 3 image features are alike, 6 are needed" in row
    session.select("r2", "r3")
    assert describe_cell(session) == "rejected"


def test_a_robot_that_sees_nothing_known_is_helped_by_clicks_and_named_in_the_status():
    session = OperatorSession("op")
    text = "r6 lost track of itself: it sees nothing it saw before: carried or covered?"
    session.on_fleet(fleet(6, alarms=(Alarm(robot="r6", kind="lost", text=text),)))
    record = why_record(session, "r6", {})
    assert record["alarms"] == [text] and record["alarm_kinds"] == ["lost"]
    assert not record["next"].startswith("do what its alarm says")
    assert f"alarm: r6: {text}" in status_text(session).splitlines()
