"""The page about the field: every command of ours in it is run, in its order."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import SessionSettings, open_session
from tests.deploy.field_makers import listening_port
from tests.documents import Command, commands_in

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs/field.md").read_text()
ADDRESS = "10.0.0.1"
EXPECTED = {  # exit codes of those that tell something, where all is well
    "pose-deploy rules hall --explain robot/r1 put robot/r2/cloud": 1,
}


class Machines:
    """The keeper's folder and the other machines, in one folder; `/` of each is a folder there."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.image = folder, folder / "image"
        self.port = listening_port()
        self.router = None
        key = ec.generate_private_key(ec.SECP256R1())
        asked = x509.CertificateSigningRequestBuilder().subject_name(x509.Name([]))
        pem = asked.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
        (folder / "r3.csr").write_bytes(pem)

    def run(self, command: Command) -> subprocess.CompletedProcess[str]:
        words = [self._here(word) for word in command.words[1:]]
        if words[0] == "install":
            shutil.copy2(self.folder / "hall/bundles" / words[1], self.folder)
            words += [] if "--root" in words else ["--image", str(self.image)]
        if words == ["check"]:
            words.append(str(self._server_machine()))
        module = {"pose-deploy": "fleetpose.deploy", "hmi-client": "fleetpose.hmi_client"}
        return subprocess.run(
            [sys.executable, "-P", "-m", module[command.words[0]], *words],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            env={**os.environ, "TERM": "dumb"},
        )

    def _here(self, word: str) -> str:
        return word.replace(ADDRESS, f"127.0.0.1:{self.port}")

    def _server_machine(self) -> Path:
        """What is installed below `/`, moved to where it can be run."""
        below = self.folder / "moved"
        for path in (self.image / "etc/fleetpose").iterdir():
            moved = below / path.name
            shutil.copytree(path, moved)
            configuration = moved / "zenoh.json5"
            text = configuration.read_text()
            configuration.write_text(text.replace("/etc/fleetpose", str(below)))
        self.router = open_session(SessionSettings(config_file=below / "router-a/zenoh.json5"))
        server = Keys("hall").server_alive("a" * 12)
        self.server_token = self.router.liveliness().declare_token(server)
        return below


@pytest.fixture
def machines(tmp_path):
    made = Machines(tmp_path)
    yield made
    if made.router is not None:
        made.router.close()


def test_every_command_of_the_page_does_what_it_says(machines):
    commands = commands_in(PAGE, {"pose-deploy", "hmi-client"})
    assert len(commands) > 15
    for command in in_order(commands):
        if command.words[0] == "hmi-client":  # the screen needs a terminal and a server
            continue
        done = machines.run(command)
        expected = EXPECTED.get(str(command), 0)
        assert done.returncode == expected, (str(command), done.stdout, done.stderr)
    told = machines.run(Command(("pose-deploy", "show", "hall"))).stdout
    for who in ("robot/r1", "robot/r2", "robot/r3", "operator/anna", "observer/wall", "router/a"):
        assert who in told


def in_order(commands: list[Command]) -> list[Command]:
    """As on the page; those in paragraphs come behind the blocks they explain."""
    written = [one for one in commands if "FILE" not in one.words and one.words[1:2] != ("local",)]
    steps = [one for one in written if f"    {one}" in PAGE]
    later = [one for one in written if one not in steps]
    check_rules = [one for one in later if "--check" in one.words]
    return [*steps, *check_rules, *(one for one in later if one not in check_rules)]


def test_what_the_page_shows_of_check_is_what_it_prints(machines):
    for words in (
        ("init", "hall", "--site", "hall", "--router", f"a={ADDRESS}"),
        ("add", "hall", "operator", "anna"),
        ("install", "router-a.fleetpose"),
        ("install", "operator-anna.fleetpose", "--root", "fleet"),
    ):
        assert machines.run(Command(("pose-deploy", *words))).returncode == 0
    machines._server_machine()
    done = machines.run(Command(("pose-deploy", "check", "fleet")))
    shown = PAGE.split("```text\n")[1].split("```")[0].splitlines()
    printed = done.stdout.replace(f"127.0.0.1:{machines.port}", f"{ADDRESS}:7447").splitlines()

    def without_time(lines: list[str]) -> list[str]:
        return [line for line in lines if " clock " not in line]

    assert without_time(printed) == without_time(shown)
