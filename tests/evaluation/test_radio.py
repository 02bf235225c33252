"""The emulated radio link: its accounting, and one message through network namespaces."""

import json
import socket
import subprocess
import sys
from dataclasses import asdict, replace

import pytest

from fleetpose.evaluation.options.field import FieldOptions, RadioLink
from fleetpose.evaluation.system.radio.ages import sent_views
from fleetpose.evaluation.system.radio.air import QUEUE_S, Air
from fleetpose.evaluation.system.radio.link import Station
from fleetpose.evaluation.system.radio.namespaces import Namespace, why_impossible
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

CLEAN = RadioLink(rate_kbit=800, delay_ms=50, loss=0.0)  # 100 bytes take a millisecond
PACKET = bytes(1000)
END_S = 1e6


def test_a_packet_takes_its_time_on_the_air_and_then_the_delay():
    air = Air(CLEAN, seed=0)
    air.offer("r1", "site", PACKET, 5.0)
    assert air.arrived(5.0 + 0.0599) == []
    assert air.next_s() == pytest.approx(5.06)
    assert air.arrived(5.0601) == [("site", PACKET)]
    assert air.next_s() is None


def test_both_directions_and_all_stations_share_the_rate():
    air = Air(CLEAN, seed=0)
    senders = ("site", "r1", "r2")
    for _ in range(5):
        for sender in senders:
            air.offer(sender, "x", PACKET, 0.0)
    n = 5 * len(senders)
    assert len(air.arrived(0.05 + 0.010 * n - 0.0001)) == n - 1
    assert len(air.arrived(0.05 + 0.010 * n + 0.0001)) == 1


def test_stations_send_in_turns_however_much_one_has():
    air = Air(CLEAN, seed=0)
    for k in range(10):
        air.offer("r1", "site", bytes([1, k]) + PACKET, 0.0)
    for k in range(3):
        air.offer("r2", "site", bytes([2, k]) + PACKET, 0.0)
    order = [packet[0] for _, packet in air.arrived(END_S)]
    assert order[:7].count(2) == 3
    assert len(order) == 13


def test_packets_of_a_station_keep_their_order():
    air = Air(CLEAN, seed=0)
    for k in range(10):
        air.offer("r1", "site", bytes([k]), 0.1 * k)
    assert [packet[0] for _, packet in air.arrived(END_S)] == list(range(10))


def test_a_full_queue_drops_what_comes_last():
    air = Air(CLEAN, seed=0)
    for _ in range(100):
        air.offer("r1", "site", PACKET, 0.0)
    fits = round(QUEUE_S * 100_000 / len(PACKET)) + 1  # one is on the air
    account = air.accounts()["r1"]
    assert len(air.arrived(END_S)) == fits == account.sent
    assert account.full == 100 - fits
    air.offer("r1", "site", PACKET, END_S)
    assert account.full == 100 - fits, "the queue is empty again"


def test_losses_have_their_share_and_repeat_with_their_seed():
    def lost(seed: int) -> list[int]:
        air = Air(replace(CLEAN, loss=0.05), seed)
        found = []
        for k in range(4000):
            air.offer("r1", "site", PACKET, 0.01 * k)
            found.append(air.accounts()["r1"].lost)
        return found

    first = lost(1)
    assert first == lost(1) != lost(2)
    assert 0.03 < first[-1] / 4000 < 0.07


def test_a_link_that_is_down_loses_everything_and_takes_its_time():
    air = Air(CLEAN, seed=0)
    air.down = True
    air.offer("r1", "site", PACKET, 0.0)
    assert air.arrived(1.0) == []
    air.down = False
    air.offer("r1", "site", PACKET, 1.0)
    assert len(air.arrived(END_S)) == 1
    assert asdict(air.accounts()["r1"]) == {"sent": 2, "bytes": 2000, "lost": 1, "full": 0}


def test_a_link_is_told_by_three_numbers():
    from fleetpose.evaluation.options.field import RADIO

    assert RADIO.read("--radio", "2000,50,0.05") == RadioLink(2000, 50, 0.05)
    assert RADIO.read("--radio", "") is FieldOptions().radio is None
    assert RADIO.read("--radio", RADIO.shown(CLEAN)) == CLEAN
    for wrong in ("2000", "0,50,0.05", "2000,50,5", "fast,50,0.05"):
        with pytest.raises(FleetPoseError, match="RATE_KBIT"):
            RADIO.read("--radio", wrong)


def test_views_are_read_from_an_agents_log():
    log = (
        "2026-12-02T14:18:43.050Z INFO fleetpose.robot_agent.sender view dropped name=r1/a/1 "
        "reason=newer\n"
        "2026-12-02T14:18:45.381Z INFO fleetpose.robot_agent.sender view name=r1/a/0 salient=1600 "
        "bytes=191642 image_bytes=0 encode_ms=430.8 put_ms=200.0\n"
    )
    (view,) = sent_views(log)
    assert (view.name, view.bytes, view.salient) == ("r1/a/0", 191642, 1600)
    assert view.put_s % 60 == pytest.approx(45.181)


@pytest.fixture
def networks():
    """Two network namespaces."""
    if why := why_impossible():
        pytest.skip(why)
    made = Namespace(), Namespace()
    yield made
    for namespace in made:
        namespace.close()


def test_a_message_passes_between_namespaces_and_nothing_is_left(networks):
    ends = [Station(f"s{k}", f"10.77.0.{k + 1}/24", one.path) for k, one in enumerate(networks)]
    arguments = [json.dumps(asdict(CLEAN)), "0", *(json.dumps(asdict(end)) for end in ends)]
    module = "fleetpose.evaluation.system.radio.link"
    here = devices()
    with subprocess.Popen(
        [sys.executable, "-P", "-m", module, *arguments], stdout=subprocess.PIPE, text=True
    ) as link:
        try:
            assert link.stdout is not None
            assert json.loads(link.stdout.readline()) == {"down": False, "stations": {}}
            with networks[1].entered(), socket.socket(type=socket.SOCK_DGRAM) as receiver:
                receiver.bind(("10.77.0.2", 9000))
                receiver.settimeout(0.2)
                with networks[0].entered(), socket.socket(type=socket.SOCK_DGRAM) as sender:
                    got: list[bytes] = []

                    def passed() -> bool:
                        sender.sendto(b"hello", ("10.77.0.2", 9000))
                        try:
                            got.append(receiver.recv(100))
                        except TimeoutError:
                            return False
                        return True

                    assert wait_until(passed, 30.0)
            assert got == [b"hello"]
            told = json.loads(link.stdout.readline())["stations"]["s0"]
            assert told["sent"] >= 1 == told["bytes"] // told["sent"] // 33
        finally:
            link.terminate()
    assert devices() == here, "this process never left its own network"
    for namespace in networks:
        with namespace.entered():
            assert devices() == ["lo"]


def devices() -> list[str]:
    """Names of the network's devices."""
    return sorted(name for _, name in socket.if_nameindex())
