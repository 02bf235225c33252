"""What `hmi-client why` makes of the server's alarms."""

from hmi_fakes import fleet

from hmi_client.reports import status_text
from hmi_client.session import OperatorSession
from hmi_client.why import why_record, why_text
from protocol.messages import Alarm

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


def test_a_robot_that_sees_nothing_known_is_helped_by_clicks_and_named_in_the_status():
    session = OperatorSession("op")
    text = "r6 lost track of itself: it sees nothing it saw before: carried or covered?"
    session.on_fleet(fleet(6, alarms=(Alarm(robot="r6", kind="lost", text=text),)))
    record = why_record(session, "r6", {})
    assert record["alarms"] == [text] and record["alarm_kinds"] == ["lost"]
    assert not record["next"].startswith("do what its alarm says")
    assert f"alarm: r6: {text}" in status_text(session).splitlines()
