"""A router with certificates and rules: what it denies, and whom it turns away, is told by name."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("cryptography", reason="certificates are made with it")

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Denials
from fleetpose.protocol.transport import (
    Link,
    Sample,
    SessionSettings,
    free_port,
    open_session,
    wait_until,
)
from tests.integration.certificates import Authority

KEYS = Keys("demo")
QUIET = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
EVERYTHING = [
    *("put", "delete", "declare_subscriber", "query", "reply", "declare_queryable"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
]


class Site:
    """A site of certificates: a router that runs, and configurations for whoever joins."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.authority = folder, Authority(folder / "certificates")
        self.endpoint = f"tls/localhost:{free_port()}"
        self.router = self._file(
            "router",
            {
                "mode": "router",
                "listen": {"endpoints": [self.endpoint]},
                "access_control": rules(),
                "metadata": {"fleetpose": {"site": "demo", "role": "router", "name": "a"}},
            },
            self.authority.tls("router/a", listens=True),
        )

    def configuration(self, who: str, days: float = 30, authority: Authority | None = None) -> Path:
        """A client's."""
        role, _, name = who.partition("/")
        metadata = {"fleetpose": {"site": "demo", "role": role, "name": name or role}}
        content = {"mode": "client", "connect": {"endpoints": [self.endpoint]}}
        tls = (authority or self.authority).tls(who, days)
        tls["root_ca_certificate"] = str(self.authority.file)
        return self._file(who.replace("/", "-"), {**content, "metadata": metadata}, tls)

    def _file(self, stem: str, content: dict, tls: dict) -> Path:
        transport = {"shared_memory": {"enabled": False}, "link": {"tls": tls}}
        file = self.folder / f"{stem}.json5"
        file.write_text(json.dumps({**content, "scouting": QUIET, "transport": transport}))
        return file


def rules() -> dict:
    """Server and people may do everything, r2 what is its own, and learn who listens to robots;
    others nothing.
    """
    everywhere = [f"{KEYS.root}/**", f"{KEYS.root}/**/@adv/**"]
    own = [f"{KEYS.root}/robot/r2/**", f"{KEYS.root}/robot/r2/**/@adv/**"]
    both = ["ingress", "egress"]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {"id": id, "permission": "allow", "flows": flows, "messages": EVERYTHING}
            | {"key_exprs": keys}
            for id, flows, keys in (("all", both, everywhere), ("own", both, own))
        ]
        + [
            {"id": "listeners", "permission": "allow", "flows": ["egress"]}
            | {"messages": ["declare_subscriber"], "key_exprs": [KEYS.cloud("*")]}
        ],
        "subjects": [
            {"id": "desk", "cert_common_names": ["server", "health/desk", "observer/wall"]},
            {"id": "r2", "cert_common_names": ["robot/r2"]},
        ],
        "policies": [
            {"rules": ["all"], "subjects": ["desk"]},
            {"rules": ["own", "listeners"], "subjects": ["r2"]},
        ],
    }


@pytest.fixture
def site(tmp_path):
    return Site(tmp_path)


@pytest.fixture
def fleet(tmp_path, site):
    with LocalFleet(tmp_path / "logs") as started:
        started.start("router", "fleetpose.pose_server", "router", "--config", str(site.router))
        yield started


def join(file: Path, timeout_s: float = 15.0) -> Link:
    return Link(open_session(SessionSettings(config_file=file, timeout_s=timeout_s)))


@pytest.mark.timeout(120)
def test_denials_are_told_by_name_and_key_and_refused_handshakes_by_cause(site, fleet):
    desk = join(site.configuration("health/desk"))
    told: list[Denials] = []

    def take(sample: Sample) -> None:
        told.append(unpack(Denials, sample.payload, sample.encoding))

    desk.on_latched(KEYS.denials("*"), take)
    desk.on_bulk(KEYS.cloud("*"))
    r2 = join(site.configuration("robot/r2"))
    strangers = join(site.configuration("robot/stranger"))
    try:
        own = r2.bulk(KEYS.cloud("r2"))
        assert wait_until(lambda: own.wanted, 30)
        for _ in range(3):
            own.put(b"", "")
            r2.session.put(KEYS.cloud("r1"), b"")
        r2.token(KEYS.robot_alive("r1", "0" * 12))
        with pytest.raises(UnreachableError):
            r2.query(KEYS.view("r1"), 0.3)
        with pytest.raises(UnreachableError):
            join(site.configuration("robot/late", days=-1), 0.5)
        other = Authority(site.folder / "other", "authority of another site")
        with pytest.raises(UnreachableError):
            join(site.configuration("robot/r9", authority=other), 0.5)

        def denied() -> Counter:
            if not told:
                return Counter()
            assert told[-1].router == "a"
            return Counter({(one.who, one.what, one.key): one.n for one in told[-1].denied})

        put = ("robot/r2", "Put (ingress)", KEYS.cloud("r1"))
        token = ("robot/r2", "Liveliness Token (ingress)", KEYS.robot_alive("r1", "*"))
        query = ("robot/r2", "Query (ingress)", KEYS.view("r1"))
        assert wait_until(lambda: denied()[put] == 3, 30), told
        assert wait_until(lambda: denied()[token] and denied()[query], 30), told
        assert {who for who, _, _ in denied()} == {"robot/r2"}, "nobody else did wrong"
        causes = {"expired", "of another site", "a certificate that the rules do not know"}
        assert wait_until(lambda: causes <= set(told[-1].refused), 30), told[-1].refused
    finally:
        for link in (desk, r2, strangers):
            link.close()


@pytest.mark.timeout(120)
def test_the_server_tells_what_is_denied_and_why_names_it(site, fleet):
    state = ("--state-dir", str(fleet.directory / "state"), "--workers", "1")
    config = site.configuration("server")
    fleet.start("server", "fleetpose.pose_server", "run", "--config", str(config), *state)
    r2 = join(site.configuration("robot/r2"))
    try:
        assert wait_until(lambda: "serving" in fleet.tail("server"), 60), fleet.tail("server")
        for _ in range(3):
            r2.session.put(KEYS.cloud("r1"), b"")

        def status() -> str:
            command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", "status"]
            command += ["--config", str(site.configuration("observer/wall"))]
            done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
            return done.stdout + done.stderr

        said = f"denied to robot/r2: Put (ingress) on {KEYS.cloud('r1')} 3"
        assert wait_until(lambda: said in status(), 30, poll_s=0.5), status()
    finally:
        r2.close()
