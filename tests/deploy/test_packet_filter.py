"""The packet filter of a router's machine, in a network namespace of the test's own."""

import secrets
import shutil
import subprocess
import sys
from collections.abc import Iterator
from string import Template

import pytest

from fleetpose.deploy.machine import system_files

PORT = 7447
CROWD = 60
LET_IN = 11  # a burst of 6, and 5 a second
CLIENT = """
import select, socket, sys
port, crowd, family = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
family, host = (socket.AF_INET6, "::1") if family == "6" else (socket.AF_INET, "127.0.0.1")
server = socket.socket(family)
server.bind((host, port))
server.listen(crowd)
first = socket.create_connection((host, port), timeout=2)
there, _ = server.accept()
clients = [socket.socket(family) for _ in range(crowd)]
for client in clients:
    client.setblocking(False)
    client.connect_ex((host, port))
connected = set()
while ready := select.select([], [c for c in clients if c not in connected], [], 0.4)[1]:
    connected.update(ready)
there.sendall(b"still here")
first.settimeout(2)
print(len(connected), first.recv(100).decode())
"""


def run(*command: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, capture_output=True, text=True, timeout=30, check=False, **options
    )


@pytest.fixture
def namespace() -> Iterator[str]:
    if shutil.which("nft") is None or shutil.which("ip") is None:
        pytest.skip("no nft or no ip here")
    name = f"fleetpose-{secrets.token_hex(3)}"
    if run("ip", "netns", "add", name).returncode:
        pytest.skip("no network namespace can be made here")
    try:
        run("ip", "netns", "exec", name, "ip", "link", "set", "lo", "up")
        yield name
    finally:
        run("ip", "netns", "del", name)


def rules() -> str:
    return Template(system_files.template("router.nft")).substitute(port=PORT)


@pytest.mark.parametrize("family", ["4", "6"])
def test_a_crowd_of_new_connections_is_kept_out_and_a_link_that_stands_lives_on(namespace, family):
    inside = ("ip", "netns", "exec", namespace)
    crowd = (*inside, sys.executable, "-c", CLIENT, str(PORT), str(CROWD), family)
    assert run(*crowd).stdout.split()[0] == str(CROWD), "without a filter all are let in"
    for _ in range(2):  # a router that is started again loads it again
        loaded = run(*inside, "nft", "-f", "-", input=rules())
        assert loaded.returncode == 0, loaded.stderr
    connected, _, told = run(*crowd).stdout.partition(" ")
    assert 1 <= int(connected) <= LET_IN
    assert told.strip() == "still here"
