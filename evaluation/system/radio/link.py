"""A radio link between network namespaces, packet by packet, as a process of its own: each station
has a TUN device in its namespace, and what it sends goes through one `Air`.

SIGUSR1 takes the link down, SIGUSR2 up again. It prints a line of JSON when it is there, and each
second what every station has sent since.
"""

import fcntl
import ipaddress
import json
import os
import select
import signal
import struct
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass

from fleetpose.evaluation.options.field import RadioLink
from fleetpose.evaluation.system.radio.air import Air
from fleetpose.evaluation.system.radio.namespaces import enter, run

DEVICE = "radio"
_SET_INTERFACE, _TUN, _NO_INFO = 0x400454CA, 0x0001, 0x1000  # linux/if_tun.h
_LARGEST_PACKET = 65_536
_TOLD_EACH_S = 1.0
_IP_VERSION, _IP_RECEIVER = 0, slice(16, 20)


@dataclass(frozen=True)
class Station:
    """One end of the link.

    Attributes:
        address: IPv4 with its network, e.g. 10.77.0.1/24.
        namespace: path of the network that it is in.
    """

    name: str
    address: str
    namespace: str


def open_device(station: Station) -> int:
    """Makes the TUN device of a station, up and with its address; the calling thread stays in that
    network. The device is gone when the file is closed.
    """
    enter(station.namespace)
    file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(file, _SET_INTERFACE, struct.pack("16sH", DEVICE.encode(), _TUN | _NO_INFO))
    run("ip", "addr", "add", station.address, "dev", DEVICE)
    run("ip", "link", "set", DEVICE, "up")
    return file


def carry(air: Air, devices: Mapping[str, int], receivers: Mapping[bytes, str]) -> None:
    """Carries packets until the process is ended.

    Args:
        devices: the open file of each station, by its name.
        receivers: names of stations by their addresses.
    """
    senders = {file: name for name, file in devices.items()}
    tell_s = time.monotonic()
    while True:
        now_s = time.monotonic()
        for receiver, packet in air.arrived(now_s):
            with suppress(OSError):  # its kernel takes no more, as a card that is overrun
                os.write(devices[str(receiver)], packet)
        if now_s >= tell_s:
            told = {str(name): asdict(account) for name, account in air.accounts().items()}
            print(json.dumps({"down": air.down, "stations": told}), flush=True)
            tell_s = now_s + _TOLD_EACH_S
        next_s = min(tell_s, air.next_s() or tell_s)
        ready, _, _ = select.select(list(senders), [], [], max(next_s - time.monotonic(), 0.0))
        for file in ready:
            for packet in _read(file):
                receiver = receivers.get(packet[_IP_RECEIVER])
                if packet[_IP_VERSION] >> 4 == 4 and receiver is not None:
                    air.offer(senders[file], receiver, packet, time.monotonic())


def _read(file: int) -> list[bytes]:
    """All packets that wait."""
    packets = []
    with suppress(BlockingIOError):
        while True:
            packets.append(os.read(file, _LARGEST_PACKET))
    return packets


def main(arguments: Sequence[str]) -> None:
    """Arguments LINK SEED STATION..., each but the seed as JSON."""
    link, seed, *told = arguments
    stations = [Station(**json.loads(one)) for one in told]
    air = Air(RadioLink(**json.loads(link)), int(seed))

    def switch(signum: int, _: object) -> None:
        air.down = signum == signal.SIGUSR1

    for signum in (signal.SIGUSR1, signal.SIGUSR2):
        signal.signal(signum, switch)
    devices = {station.name: open_device(station) for station in stations}
    receivers = {
        ipaddress.ip_interface(station.address).ip.packed: station.name for station in stations
    }
    carry(air, devices, receivers)


if __name__ == "__main__":
    main(sys.argv[1:])
