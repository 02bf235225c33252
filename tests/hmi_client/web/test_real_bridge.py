"""Pages, the real bridge, a router and a server that is small, on this machine."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")
sys.path.insert(0, str(Path(__file__).parent))

from real_bridge import real_bridge


@pytest.fixture
def bridge(router, tmp_path):
    with real_bridge(router, tmp_path) as bridge:
        yield bridge


def test_a_click_in_the_page_becomes_a_correspondence_of_the_server(serve, bridge):
    server = serve()
    page = bridge.page()
    page.wait(lambda p: p.texts.get("step", {}).get("tone") == "ask")
    page.say(do="select", a="r1", b="r2")
    page.wait(lambda p: (1, 0) in p.binaries and (1, 1) in p.binaries)
    assert page.binaries[1, 0][8:10] == b"\xff\xd8"
    page.say(do="pick", side=0, pixel=[100.25, 120.5], view=page.image(0))
    page.wait(lambda p: p.texts["list"]["half"] == {"side": 0, "pixel": [100.25, 120.5]})
    page.say(do="pick", side=1, pixel=[140, 121], view=page.image(1))
    page.wait(lambda p: [e["status"] for e in p.texts["list"]["points"]] == ["confirmed"])
    (update,) = server.updates
    assert (list(update.pixel_i), list(update.pixel_j)) == ([100.25, 120.5], [140, 121])
    assert update.operator == "kim"
    assert page.texts["list"]["undo"] is not None


def select(page, a="r1", b="r2"):
    page.wait(lambda p: p.texts.get("names", {}).get("names"))
    page.say(do="select", a=a, b=b)
    page.wait(lambda p: p.texts["list"]["pair"] == [a, b] and (1, 0) in p.binaries)
    page.wait(lambda p: (1, 1) in p.binaries)


def pick(page, side, pixel):
    page.say(do="pick", side=side, pixel=pixel, view=page.image(side))


def test_without_a_router_the_page_comes_up_and_says_so(tmp_path):
    with real_bridge("tcp/127.0.0.1:1", tmp_path) as bridge:
        page = bridge.page()
        page.wait(lambda p: p.texts.get("health", {}).get("server") == "gone")
        assert page.texts["health"]["address"] == "tcp/127.0.0.1:1"
        assert page.texts["step"]["tone"] == "gone"
        page.say(do="next")
        page.wait(lambda p: "asks nothing" in p.texts.get("notice", {}).get("text", ""))


def test_the_next_image_waits_until_the_last_was_drawn(serve, bridge):
    serve()
    page = bridge.page(acks=False)
    page.wait(lambda p: p.texts.get("names", {}).get("names"))
    page.say(do="select", a="r1", b="r2")
    page.wait(lambda p: len(p.images) == 1)
    page.wait(lambda p: sum(m["t"] == "health" for m in p.heard) >= 3)  # two seconds of images
    assert len(page.images) == 1  # one by one until it is known how quick the link is
    first, id = page.images[0]
    page.say(do="ack", side=first, view=id)
    page.wait(lambda p: len(p.images) == 3)
    assert sorted(side for side, _ in page.images[1:]) == [0, 1]
    assert all(number > id for _, number in page.images[1:])


def test_a_pick_in_an_image_that_is_gone_is_refused_in_a_sentence(serve, bridge):
    serve()
    page = bridge.page()
    select(page)
    page.say(do="pick", side=0, pixel=[1, 1], view=10**6)
    page.wait(lambda p: "image has gone" in p.texts.get("notice", {}).get("text", ""))
    assert page.texts["list"]["half"] is None


def test_snap_tells_the_page_where_the_corner_is(serve, bridge):
    serve()
    page = bridge.page()
    select(page)
    page.say(do="snap", side=0, pixel=[83, 82], view=page.image(0))
    page.wait(lambda p: "cursor" in p.texts)
    u, v = page.texts["cursor"]["pixel"]
    assert abs(u - 79.5) < 1 and abs(v - 79.5) < 1 and page.texts["cursor"]["side"] == 0


def test_after_the_first_click_the_page_is_told_where_the_other_half_is_expected(serve, bridge):
    serve()
    page = bridge.page()
    select(page)
    for k, (u, v) in enumerate(((100, 100), (500, 120), (300, 400))):
        pick(page, 0, [u, v])
        page.wait(lambda p: p.texts["list"]["half"] is not None)
        pick(page, 1, [u + 10, v])
        page.wait(lambda p, n=k: len([e for e in p.texts["list"]["points"] if e["id"]]) == n + 1)
    pick(page, 0, [200, 200])
    page.wait(lambda p: p.texts["assist"]["expected"] is not None)
    assert page.texts["assist"]["side"] == 1
    assert len(page.texts["assist"]["expected"]["pixel"]) == 2


def test_two_operators_see_each_others_pair_and_tabs_of_one_share_a_desk(serve, router, tmp_path):
    serve()
    tokens = {"token-of-kim-0000": "kim", "token-of-ana-0000": "ana"}
    with real_bridge(router, tmp_path, tokens) as bridge:
        kim, tab, ana = (
            bridge.page(t) for t in ("token-of-kim-0000", "token-of-kim-0000", "token-of-ana-0000")
        )
        assert bridge.page("token-of-nobody-0").wait(lambda p: p.code == 4401) is None
        select(kim)
        tab.wait(lambda p: p.texts["list"]["pair"] == ["r1", "r2"], 1.0)
        began = time.monotonic()
        select(ana)
        kim.wait(lambda p: p.texts["list"]["others"] == ["ana"], 1.0)
        ana.wait(lambda p: p.texts["list"]["others"] == ["kim"], 1.0)
        assert time.monotonic() - began < 2.0
        pick(ana, 0, [100, 100])
        ana.wait(lambda p: p.texts["list"]["half"] is not None)
        pick(ana, 1, [110, 100])
        tab.wait(lambda p: [e["by"] for e in p.texts["list"]["points"]] == ["ana"])
        assert kim.texts["welcome"]["operator"] == "kim"
        assert ana.texts["welcome"]["operator"] == "ana"
        ana.say(do="select", a="r2", b="r3")
        kim.wait(lambda p: p.texts["list"]["elsewhere"] == {"ana": ["r2", "r3"]}, 1.0)


def test_how_a_page_looks_is_kept_and_its_token_outlives_the_bridge(router, tmp_path):
    with real_bridge(router, tmp_path) as bridge:
        page = bridge.page()
        page.say(do="settings", set={"theme": "light"})
        page.say(do="ping", at=3.5)
        page.wait(lambda p: p.texts.get("pong") == {"t": "pong", "at": 3.5})
    with real_bridge(router, tmp_path) as bridge:
        page = bridge.page()
        page.wait(lambda p: "welcome" in p.texts)
        assert page.texts["welcome"]["settings"] == {"theme": "light"}


def test_matrix_and_map_come_in_the_order_of_names_and_only_if_wanted(serve, bridge):
    serve()
    page = bridge.page()
    page.wait(lambda p: (2, 0) in p.binaries and (3, 0) in p.binaries)
    names = page.texts["names"]["names"]
    assert names == [f"r{k}" for k in range(1, 7)]
    poses = np.frombuffer(page.binaries[3, 0], "<f4", offset=8).reshape(6, 8)
    assert np.isnan(poses[5, 0]) and poses[0, 6] == 1 and poses[4, 6] == 0
    other = bridge.page()
    other.say(do="want", images=True, clouds=False, matrix=False)
    page.say(do="want", images=True, clouds=False, matrix=False)
    page.wait(lambda p: sum(m["t"] == "health" for m in p.heard) >= 3)
    page.binaries.clear()
    page.say(do="hide-more")
    page.wait(lambda p: sum(m["t"] == "health" for m in p.heard) >= 5)
    assert (2, 0) not in page.binaries


def test_why_lists_what_is_known_of_a_robot_to_who_asked(serve, bridge):
    serve()
    page, other = bridge.page(), bridge.page()
    page.wait(lambda p: p.texts.get("names", {}).get("names"))
    page.say(do="why", robot="r6")
    page.wait(lambda p: p.texts.get("why", {}).get("robot") == "r6")
    assert page.texts["why"]["lines"][0] == "r6 is not located"
    assert page.texts["why"]["lines"][-1].startswith("next: ")
    page.say(do="why", robot="<b>x</b>")
    page.wait(lambda p: "no robot '<b>x</b>'" in p.texts.get("notice", {}).get("text", ""))
    assert "why" not in other.texts


def test_a_taken_port_is_a_sentence(bridge):
    from fleetpose.hmi_client.errors import OperatorError
    from fleetpose.hmi_client.web.gate import Address

    port = int(bridge.url.rstrip("/").rpartition(":")[2])
    with pytest.raises(OperatorError, match=f"127.0.0.1:{port} cannot be listened at.*--listen"):
        Address("127.0.0.1", port).open()


def test_what_a_real_server_answers_to_others_is_a_refusal(bridge):
    from websockets.exceptions import InvalidStatus

    for origin in ("http://evil.example", "null", None):
        with pytest.raises(InvalidStatus, match="403"):
            bridge.page(origin=origin)
    page = bridge.page()
    page.wait(lambda p: "welcome" in p.texts)
    page.say_raw('{"do": "next", "robot": "' + "x" * 70_000 + '"}')
    page.wait(lambda p: p.code == 1009)
    bridge.page().wait(lambda p: "welcome" in p.texts)
