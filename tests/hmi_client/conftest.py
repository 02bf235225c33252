"""Shared by the tests of the operator's clients: a fake server, pictures."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from hmi_fakes import fleet
from hmi_server import FakeServer
from screen_makers import Clock

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.transport import SessionSettings, open_session


def checkered(robot: str, seq: int) -> bytes:
    """A 640x480 JPEG with the robot's name."""
    rows, columns = np.mgrid[0:480, 0:640]
    shade = (((rows // 40 + columns // 40) % 2) * 120 + 60).astype(np.uint8)
    image = cv2.merge((shade, np.full_like(shade, 90), np.full_like(shade, (37 * seq) % 200)))
    cv2.putText(image, robot, (200, 260), cv2.FONT_HERSHEY_SIMPLEX, 4, (255, 255, 255), 8)
    return cv2.imencode(".jpg", image)[1].tobytes()


@pytest.fixture
def serve(router):
    """Starts fake servers on the router: `serve(count=6, ...)`."""
    servers = []

    def start(**options) -> FakeServer:
        servers.append(FakeServer(router, **({"pictures": checkered} | options)))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


@pytest.fixture
def client_of(router):
    """Starts clients on the router: `client_of(session)`."""
    from fleetpose.hmi_client.network.client import Client
    from fleetpose.protocol.keys import Keys
    from fleetpose.protocol.transport import Link

    clients = []

    def start(session) -> Client:
        settings = SessionSettings(connect=(router,), timeout_s=5.0)
        clients.append(Client(session, Keys("demo"), lambda: Link(open_session(settings))))
        clients[-1].start()
        return clients[-1]

    yield start
    for client in clients:
        client.close()
        assert client.failure is None


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    s = OperatorSession("anna", clock=clock)
    s.on_fleet(fleet(6))
    return s
