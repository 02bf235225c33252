"""At a site with certificates and rules, a recorder hears what is said, and a stranger to that role
does not record.
"""

import subprocess
import sys

import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.pose_server.recording.site import SiteRecorder
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Recording
from fleetpose.protocol.transport import Link, wait_until
from tests.deploy.field_makers import Field

K = Keys("demo")
WAIT_S = 30.0


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    made = Field(tmp_path_factory.mktemp("field"))
    made.keeper.add("recorder", ["log"])
    return made


def test_a_recorder_hears_clouds_images_clicks_and_receipts_through_the_rules(field, tmp_path):
    path = tmp_path / "site.mcap"
    with LocalFleet(field.folder / "logs") as fleet:
        config = field.configuration("router/a")
        fleet.endpoint = f"tcp/127.0.0.1:{field.router().port}"
        fleet.start("router", "fleetpose.pose_server", "router", "--config", str(config))
        fleet.wait_accepting()
        members = ("server", "robot/r1", "operator/anna", "recorder/log")
        links = {who: Link(field.open(who)) for who in members}
        try:
            robot, anna, server = (links[who] for who in ("robot/r1", "operator/anna", "server"))
            robot.token(K.robot_alive("r1", "0123456789ab"))
            recorder = SiteRecorder(links["recorder/log"], K, path)
            said = {
                K.cloud("r1"): robot.bulk(K.cloud("r1")),
                K.image("r1"): robot.bulk(K.image("r1")),
                K.odometry("r1"): robot.latched(K.odometry("r1")),
                K.updates("anna"): anna.latched(K.updates("anna")),
                K.receipts("anna"): server.latched(K.receipts("anna")),
                K.pose("r1"): server.latched(K.pose("r1")),
            }
            wanted = {*said, K.robot_alive("r1", "0123456789ab")}

            def all_kept() -> bool:
                """Says it again until it is in the file: links and rules take their time."""
                for publisher in said.values():
                    publisher.put(b"said", "text/plain")
                if recorder.recorder.written < len(wanted):
                    return False
                return {record.sample.key for record in Recording(path)} == wanted

            assert wait_until(all_kept, WAIT_S, poll_s=0.5)
            recorder.close()
        finally:
            for link in links.values():
                link.close()


def test_the_command_names_whose_configuration_it_takes(field, tmp_path):
    out = tmp_path / "site.mcap"
    told = ("--config", str(field.configuration("operator/anna")), "--out", str(out))
    command = [sys.executable, "-P", "-m", "fleetpose.pose_server", "record", *told]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "take that of a recorder or a server" in done.stderr
    assert not out.exists()
