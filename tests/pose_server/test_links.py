"""Robots whose links are slow are told, and their clocks are not blamed for it."""

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.calibration.links import KEPT_VIEWS
from tests.pose_server.scene import EPOCH
from tests.pose_server.test_flows import kept, site_of
from tests.pose_server.test_lives import messages

LATE_S = 5.0


def alarms(on_way_s: float, share: float) -> dict[str, str]:
    """Of a robot whose views all arrive late, by kind."""
    site = site_of()
    pipeline.receive_token(site, "r1", EPOCH, True)
    (message,) = messages(np.eye(4))
    told = {"on_way_s": on_way_s, "share": share}
    view = kept(message.model_copy(update=told))
    for _ in range(KEPT_VIEWS + 1):
        monitor.note_arrival(site, view, view.stamp_ns + int(LATE_S * 1e9))
    monitor.judge_calibrations(site)
    return {alarm.kind: alarm.text for alarm in site.alarms.standing}


@pytest.mark.parametrize(("on_way_s", "share"), [(4.0, 1.0), (2.0, 0.25)])
def test_a_link_that_delays_views_is_named_and_no_clock(on_way_s, share):
    told = alarms(on_way_s, share)
    assert set(told) == {"link"}
    assert f"a view takes {on_way_s:.1f} s and holds {share:.0%}" in told["link"]


def test_a_clock_that_is_behind_is_told_where_the_link_is_fast():
    assert set(alarms(0.1, 1.0)) == {"clock"}


def test_views_that_were_made_smaller_are_told():
    assert "only with 35% of its salient points" in alarms(0.6, 0.35)["link"]
