"""Which server of a site is listened to."""

import pytest

from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.presence import LiveServer

KEYS = Keys("demo")
A, B, LIAR = "a" * 12, "b" * 12, "f" * 12


class Network:
    """A link of which the test says which tokens are there."""

    def __init__(self) -> None:
        self.tokens: list[str] = []
        self.asked = 0

    def on_alive(self, key_expr, callback):
        self.note = callback

    def alive(self, key_expr, timeout_s):
        self.asked += 1
        return [KEYS.server_alive(epoch) for epoch in self.tokens]

    def show(self, epoch, alive=True):
        self.note(KEYS.server_alive(epoch), alive)


@pytest.fixture
def network():
    return Network()


@pytest.fixture
def server(network):
    return LiveServer(network, KEYS)


def refused(server, epoch):
    try:
        server.check(epoch, "a pose")
    except CodecError as error:
        return str(error)
    return None


def test_without_a_token_nobody_is_the_server(server):
    assert server.epoch is None and server.absent_s >= 0.0
    assert refused(server, A) == f"a pose of server {A} that is not alive: alive is none"


def test_the_last_token_is_the_live_one_until_it_goes(server, network):
    network.show(A)
    assert server.epoch == A and server.absent_s == 0.0 and refused(server, A) is None
    network.show(B)
    assert refused(server, B) is None and f"alive is {B}" in refused(server, A)
    network.show(B, alive=False)
    assert refused(server, A) is None
    network.show(A, alive=False)
    assert server.epoch is None and refused(server, A)


def test_a_message_that_overtakes_its_servers_token_is_taken(server, network):
    network.tokens.append(A)
    assert [refused(server, A) for _ in range(5)] == [None] * 5
    assert network.asked == 1


def test_a_replaced_servers_word_is_not_taken_though_its_token_is_still_there(server, network):
    network.tokens += [A, B]
    network.show(A)
    network.show(B)
    assert refused(server, A) and refused(server, B) is None


def test_a_flood_of_strangers_asks_the_network_once_in_a_lease(server, network):
    network.tokens.append(A)
    network.show(A)
    assert all(refused(server, f"{n:012x}") for n in range(500))
    assert network.asked == 1 and refused(server, A) is None


def test_a_token_that_is_no_epoch_is_nobody(server, network):
    network.note("fleet/demo/server/alive/x", True)
    assert server.epoch is None


def test_a_token_that_comes_while_the_network_is_asked_counts(server, network):
    network.tokens.append(A)
    ask = network.alive
    network.alive = lambda *call: (network.show(A), ask(*call))[1]
    assert refused(server, A) is None
