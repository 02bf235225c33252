"""The status as Prometheus scrapes it."""

import subprocess
import sys
from urllib.request import urlopen

import pytest

from fleetpose.pose_server.app.metrics import Metrics
from fleetpose.pose_server.app.status import Stages
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import ServerStatus
from fleetpose.protocol.transport import free_port
from tests.protocol.message_examples import EXAMPLES


def scraped(port: int) -> dict[str, float]:
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
        lines = answer.read().decode().splitlines()
    found = (line.rsplit(" ", 1) for line in lines if line and not line.startswith("#"))
    return {name: float(value) for name, value in found}


def test_a_scrape_shows_the_newest_status():
    port = free_port()
    metrics = Metrics(str(port))
    try:
        assert scraped(port) == {}
        metrics.show(EXAMPLES[ServerStatus], robots=3, located=2)
        found = scraped(port)
    finally:
        metrics.close()
    assert found["fleetpose_views_total"] == 1
    assert found["fleetpose_robots"] == 3 and found["fleetpose_robots_located"] == 2
    assert found['fleetpose_waiting{line="joining"}'] == 3
    assert found['fleetpose_stage_seconds{stage="solve"}'] == pytest.approx(5.5e-3)
    assert found['fleetpose_drops_total{reason="codec"}'] == 1


@pytest.mark.parametrize("where", ["", "here", "127.0.0.1:", "127.0.0.1:99999"])
def test_what_is_no_address_is_refused_with_a_sentence(where):
    with pytest.raises(FleetPoseError, match="--metrics"):
        Metrics(where)


def test_a_server_with_such_an_address_ends_with_the_sentence(tmp_path):
    options = ("--listen", "tcp/127.0.0.1:0", "--state-dir", str(tmp_path), "--metrics", "here")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "fleetpose.pose_server", "run", *options],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert "--metrics here: write HOST:PORT" in done.stderr and "Traceback" not in done.stderr


def test_an_address_in_use_is_refused_with_a_sentence():
    first = Metrics(port := f"127.0.0.1:{free_port()}")
    try:
        with pytest.raises(FleetPoseError, match="in use"):
            Metrics(port)
    finally:
        first.close()


def test_stages_are_told_by_their_medians():
    stages = Stages()
    stages.note({"icp": 1.0})
    stages.note({"icp": 3.0})
    stages.note({"icp": 100.0})
    with stages.timed("solve"):
        pass
    assert stages.medians_ms()["icp"] == 3.0
    assert stages.medians_ms()["solve"] >= 0.0
