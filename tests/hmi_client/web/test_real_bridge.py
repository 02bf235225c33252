"""Pages, the real bridge, a router and a server that is small, on this machine."""

import sys
from pathlib import Path

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
