"""The command line against a fake server over real zenoh."""

import csv
import json
import subprocess
import sys
import threading
from datetime import datetime

import hmi_fakes
import hmi_server
import pytest
from hmi_fakes import CAMERA, ROBOT_EPOCH, alignment, wait_for

from fleetpose.hmi_client.__main__ import main
from fleetpose.protocol.messages import CameraAnnouncement, Denial
from fleetpose.protocol.transport import Link, SessionSettings, free_port, open_session


@pytest.fixture
def hmi(router, monkeypatch, capsys):
    """Runs `hmi-client` in this process: `hmi("status", code=0)` returns its output."""

    def run(*arguments: str, code: int = 0) -> str:
        monkeypatch.setattr(sys, "argv", ["hmi-client", *arguments, "--connect", router])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        output = captured.out + captured.err
        assert (ended.value.code or 0) == code, output
        return output

    return run


def test_add_waits_for_the_receipt_and_prints_ids(hmi, serve):
    server = serve()
    output = hmi("correspondences", "add", "r1", "r2", "10,20,30,40", "11,21,31,41")
    assert "accepted r1 - r2, id 1" in output and "id 2" in output
    assert [tuple(c.pixel_i) for c in server.sets[("r1", "r2")].items] == [(10, 20), (11, 21)]


def test_robots_in_the_other_order_swap_pixels_and_views(hmi, serve):
    server = serve()
    hmi("correspondences", "add", "r2", "r1", "10,20,30,40", "--view-i", "3", "--view-j", "5")
    [c] = server.sets[("r1", "r2")].items
    assert tuple(c.pixel_i) == (30, 40) and tuple(c.pixel_j) == (10, 20)
    assert (c.view_i.seq, c.view_j.seq) == (5, 3)


def test_a_rejection_is_told_and_exits_with_1(hmi, serve):
    serve()
    output = hmi("correspondences", "add", "r1", "r2", "1,2,3,4", "630,2,3,4", code=1)
    assert "rejected r1 - r2: the pixel has no depth" in output and "accepted" in output


def test_without_a_receipt_it_says_that_nothing_is_known_and_exits_with_3(hmi, serve):
    serve(mute=True)
    output = hmi("correspondences", "add", "r1", "r2", "1,2,3,4", "--timeout", "0.5", code=3)
    assert "not known" in output


def test_clicks_that_a_router_denies_are_told_from_those_that_nobody_hears(hmi, serve, monkeypatch):
    updates = "fleet/demo/operator/anna/correspondences"
    denied = (
        Denial(who="operator/ben", what="Put (ingress)", key=updates, n=9),
        Denial(who="operator/anna#2", what="Put (ingress)", key="fleet/demo/pose/r1", n=9),
        Denial(who="operator/anna#2", what="Put (ingress)", key=updates, n=1),
    )
    monkeypatch.setattr(
        hmi_server,
        "status",
        lambda *told: hmi_fakes.status(*told).model_copy(update={"denied": denied}),
    )
    server = serve(mute=True)
    add = ("correspondences", "add", "r1", "r2", "1,2,3,4", "--operator")
    assert f"denied by the router's rules: Put (ingress) on {updates}" in hmi(
        *add, "anna", "--timeout", "1", code=3
    )
    assert "the server is there, but" in hmi(*add, "carl", "--timeout", "1", code=3)

    ending = threading.Timer(3.0, server.close)
    ending.start()
    assert "not heard, no server is there" in hmi(*add, "carl", "--timeout", "9", code=3)
    ending.join()


def test_erase_clear_and_list(hmi, serve):
    server = serve()
    hmi("correspondences", "add", "r1", "r2", "1,2,3,4", "5,6,7,8", "9,10,11,12")
    listed = json.loads(hmi("correspondences", "list", "r2", "r1", "--json"))
    assert [(r["id"], r["u_i"], r["status"]) for r in listed] == [
        (1, 1.0, "accepted"),
        (2, 5.0, "accepted"),
        (3, 9.0, "accepted"),
    ]
    assert "erased 2" in hmi("correspondences", "erase", "r1", "r2", "2")
    assert [c.id for c in server.sets[("r1", "r2")].items] == [1, 3]
    assert "it has: 1, 3" in hmi("correspondences", "erase", "r1", "r2", "2", code=2)
    assert "cleared r1 - r2" in hmi("correspondences", "clear", "r1", "r2")
    assert server.sets[("r1", "r2")].items == ()
    assert "no correspondences" in hmi("correspondences", "list")


@pytest.mark.parametrize("ending", ["csv", "json"])
def test_what_was_exported_can_be_imported(hmi, serve, tmp_path, ending):
    server = serve()
    file = tmp_path / f"clicks.{ending}"
    hmi("correspondences", "add", "r1", "r2", "1.25,2,3,4", "5,6,7,8")
    assert "2 correspondences of 1 pairs" in hmi("correspondences", "export", str(file))
    before = server.sets[("r1", "r2")].items
    assert "2 are there already" in hmi("correspondences", "import", str(file))
    hmi("correspondences", "clear", "r1", "r2")
    assert "accepted" in hmi("correspondences", "import", str(file))
    after = server.sets[("r1", "r2")].items
    assert [(c.view_i, tuple(c.pixel_i)) for c in after] == [
        (c.view_i, tuple(c.pixel_i)) for c in before
    ]


def test_an_import_without_views_uses_the_newest_ones(hmi, serve, tmp_path):
    server = serve()
    file = tmp_path / "clicks.csv"
    with file.open("w", newline="") as out:
        csv.writer(out).writerows(
            [["i", "j", "u_i", "v_i", "u_j", "v_j"], ["r2", "r1", 1, 2, 3, 4]]
        )
    hmi("correspondences", "import", str(file))
    [c] = server.sets[("r1", "r2")].items
    assert tuple(c.pixel_j) == (1, 2) and c.view_i.robot == "r1"


def test_a_broken_import_names_the_record_and_sends_nothing(hmi, serve, tmp_path):
    server = serve()
    file = tmp_path / "clicks.csv"
    file.write_text("i,j,u_i,v_i,u_j,v_j\nr1,r2,1,2,3,4\nr1,r2,1,2,3,x\n")
    assert "record 2" in hmi("correspondences", "import", str(file), code=2)
    assert server.updates == []


def test_bad_input_exits_with_2_and_says_what_to_do(hmi, serve):
    serve()
    assert "write U1,V1,U2,V2" in hmi("correspondences", "add", "r1", "r2", "1,2,3", code=2)
    assert "known robots: r1" in hmi("correspondences", "add", "r1", "r99", "1,2,3,4", code=2)
    assert "no robot 'r99'" in hmi("why", "r99", code=2)


def test_status_shows_robots_and_questions(hmi, serve):
    serve()
    output = hmi("status")
    assert "4 of 6 robots located, origin r1" in output
    assert "alive, but no pair of it could be aligned" in output
    assert "r5 - r6" in output and "it would join two parts of the fleet" in output


def test_why_gives_the_reason_what_is_known_and_what_to_do(hmi, serve):
    server = serve()
    server.put(server.keys.alignment("r4", "r6"), alignment("r4", "r6"))
    hmi("correspondences", "add", "r4", "r6", "1,2,3,4")
    output = hmi("why", "r6", code=1)
    assert "r6 is not located: alive, but no pair" in output
    assert "newest view r6/" in output and "5 views kept" in output and "no pose" in output
    assert "question 1: r5 - r6: it would join two parts of the fleet" in output
    assert "next: click the same points in the images of r5 and r6" in output
    table = [line.split() for line in output.splitlines() if line.startswith("r")][1:]
    assert [row[:2] for row in table] == [
        ["r5", "verified"],
        ["r4", "plausible"],
        ["r3", "through"],
    ]
    assert "only 4 inliers, need 12; overlap 3 %" in output and "1 accepted" in output
    assert "2 never" in output


def test_why_of_a_located_robot_exits_with_0(hmi, serve):
    serve()
    output = hmi("why", "r3")
    assert "r3 is located" in output and "next: nothing" in output
    assert "0.3 s old" in output


def test_why_as_json_has_the_same(hmi, serve):
    server = serve()
    server.put(server.keys.alignment("r5", "r6"), alignment("r5", "r6", verdict="verified"))
    record = json.loads(hmi("why", "r6", "--json", code=1))
    assert (record["alive"], record["located"], record["pose"]) == (True, False, None)
    assert record["pairs"][0]["other"] == "r5"
    assert record["pairs"][0]["alignment"]["reasons"][0] == "only 4 inliers, need 12"
    assert record["question"]["rank"] == 1 and record["next"].startswith("click")


def test_why_does_not_disturb_selection_and_images(hmi, serve):
    server = serve()
    hmi("why", "r6", code=1)
    assert all(s.i is None for s in server.selections)


def test_why_names_the_robots_there_are_and_a_missing_server(hmi, serve):
    assert "no pose server" in hmi("why", "r6", code=3)
    serve()
    assert "known robots: r1, r2" in hmi("why", "r99", code=2)


def test_watch_prints_json_lines_of_what_changes(hmi, serve):
    serve()
    records = [json.loads(line) for line in hmi("watch", "--seconds", "1", "--json").splitlines()]
    poses = [r for r in records if r["type"] == "pose"]
    assert [r["robot"] for r in poses] == ["r1", "r2", "r3", "r4", "r5"]  # unchanged: told once
    assert poses[0]["located"] and not poses[4]["located"]
    told = [{k: v for k, v in record.items() if k != "at"} for record in records]
    assert {"type": "event", "text": "fleet solved with 4 robots"} in told
    assert [(r["i"], r["j"]) for r in told if r["type"] == "question"] == [
        ("r5", "r6"),
        ("r1", "r2"),
    ]
    assert all(datetime.fromisoformat(record["at"]).tzinfo for record in records)


def test_without_a_server_the_exit_code_is_3_and_a_sentence_says_so(hmi):
    assert "no pose server of site 'demo' answered" in hmi("status", code=3)


def test_without_a_router_the_exit_code_is_3():
    command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", "status"]
    nowhere = ["--connect", f"tcp/127.0.0.1:{free_port()}"]
    done = subprocess.run(
        command + nowhere, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 3 and "no zenoh router" in done.stderr
    assert "Traceback" not in done.stderr


def test_without_a_terminal_the_bare_command_prints_help():
    done = subprocess.run(
        [sys.executable, "-P", "-m", "fleetpose.hmi_client"],
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
        check=True,
    )
    assert "correspondences" in done.stdout


def test_a_screenshot_shows_the_fleet(hmi, serve, tmp_path):
    server = serve()
    out = tmp_path / "screen.svg"
    hmi("screenshot", "--out", str(out), "--size", "120x36", "--pair", "r2,r1")
    svg = out.read_text()
    assert "view&#160;" in svg and "fleet&#160;from&#160;above" in svg and "▀" in svg
    wait_for(lambda: not server.image_wanted("r1"))  # the client has left


@pytest.fixture
def link(router):
    """A link of somebody who listens."""
    opened = Link(open_session(SessionSettings(connect=(router,), timeout_s=5)))
    yield opened
    opened.close()


@pytest.fixture
def configured(router, tmp_path):
    """Writes a configuration for the router: `configured("observer", "wall")`."""

    def write(role: str, name: str, site: str = "demo") -> str:
        file = tmp_path / f"{role}.json5"
        metadata = {"fleetpose": {"site": site, "role": role, "name": name}}
        quiet = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
        content = {"mode": "client", "metadata": metadata, "scouting": quiet}
        file.write_text(json.dumps(content | {"connect": {"endpoints": [router]}}))
        return str(file)

    return write


def test_an_observer_sees_all_and_says_nothing(hmi, serve, link, configured):
    server = serve()
    said = link.on_bulk("fleet/demo/operator/**")
    wall = ("--config", configured("observer", "wall"))
    assert "4 of 6 robots located" in hmi("status", *wall)
    assert "you may only look" in hmi(
        "correspondences", "add", "r1", "r2", "1,2,3,4", *wall, code=2
    )
    assert not server.updates and not server.selections and said.take(0) is None


def test_status_tells_denials_and_robots_of_another_version(hmi, serve, monkeypatch):
    cloud = "fleet/demo/robot/r1/cloud"
    denied = tuple(
        Denial(who="robot/r2", what=what, key=cloud, n=n)
        for what, n in (("Put (ingress)", 31), ("Query (ingress)", 4), ("a", 3), ("b", 2))
    )
    changed = {"denied": denied, "refused": {"expired": 3}}
    monkeypatch.setattr(
        hmi_server, "status", lambda *told: hmi_fakes.status(*told).model_copy(update=changed)
    )
    server = serve(live=False)
    for robot, version in (("r1", "0.1.0"), ("r2", "0.0.9"), ("r3", "")):
        announced = CameraAnnouncement(
            robot=robot, epoch=ROBOT_EPOCH, camera=CAMERA, rate_hz=1.0, version=version
        )
        server.put(server.keys.camera(robot), announced)
    said = hmi("status")
    assert f"denied to robot/r2: Put (ingress) on {cloud} 31, Query (ingress) on {cloud} 4" in said
    assert "and 1 more kinds" in said and "turned away: expired 3" in said
    assert "not of the server's version 0.1.0: " in said and "r1 0.1.0" not in said
    assert "r2 0.0.9, r3 an older one" in said


def test_an_operators_name_and_site_are_the_configurations(hmi, serve, configured):
    server = serve()
    anna = ("--config", configured("operator", "anna"))
    hmi("correspondences", "add", "r1", "r2", "10,20,30,40", *anna)
    assert {update.operator for update in server.updates} == {"anna"}
    refused = hmi("status", *anna, "--operator", "ben", code=2)
    assert "--operator ben" in refused and "operator 'anna' of site 'demo'" in refused
    elsewhere = configured("operator", "anna", site="church")
    assert "--site demo" in hmi("status", "--config", elsewhere, "--site", "demo", code=2)
    assert "site 'church' answered" in hmi("status", "--config", elsewhere, code=3)
