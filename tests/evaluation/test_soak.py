"""What a soak does to a fleet and says of it, and a short soak of live processes."""

import errno
import itertools
import json
import random
import socket
import subprocess
import sys
import threading
from contextlib import closing, contextmanager, suppress
from dataclasses import fields, replace
from types import SimpleNamespace

import pytest

pytest.importorskip("cryptography", reason="certificates are made with it")

from fleetpose.evaluation.system.faults.clicker import Account
from fleetpose.evaluation.system.memory import family_mb
from fleetpose.evaluation.system.soak import report
from fleetpose.evaluation.system.soak.disk import LEFT_BYTES, Disk
from fleetpose.evaluation.system.soak.noting import Memory, Noting, Second
from fleetpose.evaluation.system.soak.relay import Relay
from fleetpose.evaluation.system.soak.report import Soaked, slopes_mb_per_min
from fleetpose.evaluation.system.soak.site import SteppedTruth
from fleetpose.evaluation.system.soak.stepping import Stepped, set_clock
from fleetpose.evaluation.system.soak.troubles import KINDS, Trouble, Troubles
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until
from fleetpose.robot_agent.cameras.base import Frame
from tests.evaluation.makers import pose
from tests.evaluation.test_truth import seen


def grown(process: str, life: int, from_s: int, to_s: int, mb_per_min: float) -> list[Memory]:
    return [
        Memory(t, process, 100.0 + mb_per_min * (t - from_s) / 60.0, life)
        for t in range(from_s, to_s)
    ]


def test_growth_is_that_of_the_longest_life_once_caches_are_full():
    filling = grown("server", 1, 0, 120, 60.0)
    growing = [Memory(m.at_s, "server", m.mb, 1) for m in grown("server", 1, 120, 900, 3.0)]
    again = grown("server", 2, 900, 1000, 90.0)
    short = grown("r1", 1, 0, 150, 5.0)
    slopes = slopes_mb_per_min([*filling, *growing, *again, *short])
    assert slopes["server"] == pytest.approx(3.0)
    assert slopes["r1"] is None


class FakeCamera:
    """Frames at 1000, 2000, ... ns; nothing else of them matters."""

    def frames(self):
        for k in itertools.count(1):
            yield Frame(1000 * k, *(None,) * (len(fields(Frame)) - 1))

    def close(self) -> None:
        """Nothing is held."""


def soaked(**other) -> Soaked:
    usual = {
        "robots": ("r1", "r2"),
        "seconds": [Second(float(t), 2, 0, 0.1, 0.05, 0) for t in range(10)],
        "memory": grown("server", 1, 0, 300, 0.5),
        "troubles": [Trouble(1.0, 3.0, "killed", "r1", 2.0, 0.5, True)],
        "views_s": [0.1, 0.3],
        "clicks_s": [0.01, 0.03],
        "receipted": 20,
        "account": Account([], []),
        "settled": True,
        "ended": [],
        "undecodable": 0,
    }
    return Soaked(**(usual | other))


def test_a_summary_names_the_bars_that_are_missed():
    fine = report.summarize(soaked())
    assert fine["bars_missed"] is None
    assert (fine["killed"], fine["killed_poses_away_s"], fine["frozen"]) == (1, 2.0, 0)
    assert fine["located_share"] == 1.0
    wrong = report.summarize(
        soaked(
            seconds=[Second(0.0, 2, 1, None, None, 0)],
            memory=grown("server", 1, 0, 300, 2.5),
            troubles=[Trouble(1.0, 3.0, "frozen", "server", 2.0, 0.5, False)],
            account=Account(["a click is gone"], ["another is there twice"]),
            settled=False,
            ended=["r2"],
        )
    )
    assert wrong["bars_missed"].split() == [
        *("lost", "doubled", "grave_located", "unexpected_ends", "not_flowing_again"),
        *("rss_slope_server", "settled"),
    ]


def test_a_low_share_of_located_robots_is_said(tmp_path, capsys):
    lost = [Second(float(t), 0, 0, None, None, 0) for t in range(10)]
    report.write_results(tmp_path, soaked(seconds=lost))
    assert "located_share 0.00 is low" in capsys.readouterr().out
    report.write_results(tmp_path, soaked())
    assert "is low" not in capsys.readouterr().out


def test_seeds_decide_an_order_in_which_each_kind_comes_once_before_any_comes_again():
    def order(seed: int, disk: object) -> list[str]:
        site = SimpleNamespace(disk=disk)
        troubles = Troubles(site, None, random.Random(seed), lambda *_: True)
        kinds = troubles.order()
        return [next(kinds) for _ in range(2 * len(KINDS))]

    first = order(1, object())
    assert first == order(1, object()) != order(2, object())
    assert sorted(first[: len(KINDS)]) == sorted(first[len(KINDS) :]) == sorted(KINDS)
    assert "filled" not in order(1, None)
    assert all(hasattr(Troubles, f"_{kind}") for kind in KINDS)


@contextmanager
def echoing():
    """A port where all that is sent comes back."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    there, _ = server.accept()
                except OSError:
                    return
                threading.Thread(target=echo, args=(there,), daemon=True).start()

        def echo(there: socket.socket) -> None:
            with there, suppress(ConnectionError):
                while data := there.recv(4096):
                    there.sendall(data)

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]


def received(there: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count and (part := there.recv(count - len(data))):
        data += part
    return data


def ends(there: socket.socket) -> bool:
    """Whether the other side ends it, after what is still on its way."""
    try:
        while there.recv(4096):
            continue
    except ConnectionError:
        return True
    return True


def test_a_relay_passes_everything_on_holds_back_what_a_slow_link_would_and_cuts():
    content = random.Random(0).randbytes(200_000)
    with echoing() as port, closing(Relay({"a": port})) as relay:
        with socket.create_connection(("127.0.0.1", relay.ports["a"]), timeout=20) as there:
            threading.Thread(target=there.sendall, args=(content,), daemon=True).start()
            assert received(there, len(content)) == content
            relay.bytes_per_s = 1.0
            there.setblocking(False)
            with pytest.raises(BlockingIOError):
                for _ in range(1000):  # 200 MB: more than any buffer takes
                    there.send(content)
            there.settimeout(20)
            relay.cut()
            assert ends(there)
        assert wait_until(lambda: not relay.passing, 20)
        relay.bytes_per_s = None
        with socket.create_connection(("127.0.0.1", relay.ports["a"]), timeout=20) as there:
            there.sendall(b"again")
            assert received(there, 5) == b"again"


def test_a_relay_ends_what_comes_for_a_router_that_is_down():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with (
        closing(Relay({"a": port})) as relay,
        socket.create_connection(("127.0.0.1", relay.ports["a"]), timeout=20) as there,
    ):
        assert ends(there)


def test_the_stamps_of_a_robot_whose_clock_is_set_are_those_of_the_clock(tmp_path):
    clock = tmp_path / "clock"
    set_clock(clock, 0)
    frames = Stepped(FakeCamera(), clock).frames()
    assert next(frames).stamp_ns == 1_000
    set_clock(clock, -300)
    assert next(frames).stamp_ns == 1_700


def test_truth_is_that_of_the_world_by_whatever_clock_a_view_was_stamped(tmp_path):
    there, now = pose(10.0), seen("r1")
    (tmp_path / "truth").write_text(json.dumps({"radius_m": 10.0, "T_world_robots": {}}))
    moment = {"robot": "r1", "stamp_ns": now.view.stamp_ns, "T_world_robot": there.tolist()}
    (tmp_path / "truth.log.jsonl").write_text(json.dumps(moment) + "\n")
    truth = SteppedTruth(tmp_path / "truth", ("r1",))
    late = replace(now, view=now.view.model_copy(update={"stamp_ns": now.view.stamp_ns - 5}))
    assert truth.T_world_robot(late) is None
    truth.set("r1", -5)
    truth.set("r1", 0)
    assert truth.T_world_robot(late) == pytest.approx(there)
    assert truth.T_world_robot(now) == pytest.approx(there)
    assert truth.ahead_ns == {"r1": 0}


@pytest.fixture
def disk(tmp_path):
    try:
        made = Disk(tmp_path / "disk")
    except (FleetPoseError, OSError) as error:
        pytest.skip(f"nothing may be mounted here: {error}")
    yield made
    made.close()
    assert not (tmp_path / "disk").is_mount()


def test_a_disk_that_is_filled_takes_next_to_nothing_until_it_is_emptied(disk):
    content = bytes(2 * LEFT_BYTES)
    disk.fill()
    with pytest.raises(OSError) as failed:
        (disk.folder / "file").write_bytes(content)
    assert failed.value.errno == errno.ENOSPC
    disk.empty()
    (disk.folder / "file").write_bytes(content)


def test_memory_of_a_process_that_is_gone_is_none_and_of_a_family_that_of_all():
    code = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'input()'])"
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    try:
        assert wait_until(lambda: len(family_mb(process.pid)) == 2, 30.0)
        assert min(family_mb(process.pid).values()) > 0
    finally:
        process.communicate(b"\n")
    assert family_mb(process.pid) == {}


def test_what_goes_wrong_while_noting_is_told_at_the_end():
    def fails() -> float:
        raise ZeroDivisionError

    observer = SimpleNamespace(view_to_pose_s=[], state=None, poses=fails)
    site = SimpleNamespace(truth=SimpleNamespace(ahead_ns={}), robots=())
    clicker = SimpleNamespace(waits_s=[])
    noting = Noting(site, observer, clicker, None, (), lambda: None)
    with pytest.raises(ZeroDivisionError), noting:
        assert wait_until(lambda: not noting.is_alive(), 20.0)
