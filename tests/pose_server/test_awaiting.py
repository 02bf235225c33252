"""Updates wait for what a young server has not heard of yet, and are not refused for it."""

from hypothesis import given
from hypothesis import strategies as st

from fleetpose.pose_server.app.pending_updates import StartupGrace
from fleetpose.protocol.messages import OperatorUpdate, ViewName


def add(n: int, i: str = "r1", j: str = "r2") -> OperatorUpdate:
    epoch = "0" * 12
    return OperatorUpdate.model_validate(
        {
            "operator": "anna",
            "session": epoch,
            "n": n,
            "action": "add",
            "i": i,
            "j": j,
            "base_revision": 0,
            "view_i": ViewName(robot=i, epoch=epoch, seq=1),
            "view_j": ViewName(robot=j, epoch=epoch, seq=1),
            "pixel_i": (1.0, 2.0),
            "pixel_j": (3.0, 4.0),
        }
    )


def clear(n: int) -> OperatorUpdate:
    nothing = {"view_i": None, "view_j": None, "pixel_i": None, "pixel_j": None}
    return add(n).model_copy(update={"action": "clear", **nothing})


@given(st.lists(st.sampled_from(["r1", "r2", "r3"]), unique=True))
def test_an_update_waits_exactly_until_both_robots_are_here(arriving):
    here: set[str] = set()
    early = StartupGrace(100.0, lambda view: view.robot in here)
    assert early.holds(add(1), 100.1) and early.holds(add(1), 100.2)  # repeated by its client
    for robot in arriving:
        before = {"r1", "r2"} <= here
        here.add(robot)
        found = early.ready(101.0)
        assert [u.n for u in found] == ([1] if {"r1", "r2"} <= here and not before else [])


def test_robots_that_never_come_are_not_waited_for_for_ever():
    early = StartupGrace(100.0, lambda _: False)
    assert early.holds(add(2), 100.1) and early.holds(add(1), 100.2)
    assert early.ready(109.0) == []
    assert [update.n for update in early.ready(110.0)] == [1, 2]
    assert not early.holds(add(3), 110.0)


def test_what_names_no_view_does_not_wait():
    assert not StartupGrace(100.0, lambda _: False).holds(clear(1), 100.1)
