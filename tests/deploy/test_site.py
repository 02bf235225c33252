"""A site's folder: who belongs to it, what is issued, and what a revocation leaves."""

import json
import stat
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from fleetpose.deploy.archive import unpacked
from fleetpose.deploy.errors import SiteError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.machine.bundle import read_bundle
from fleetpose.deploy.site.explain import allowing, explain
from fleetpose.deploy.site.folder import Site, SiteFolder, router_address
from fleetpose.deploy.site.issuing import Keeper, hash_of, make_site
from fleetpose.deploy.site.rules import INGRESS, PUT, access_control
from fleetpose.deploy.site_commands import is_public
from tests.deploy.field_makers import Field, no_password

ROBOTS_OF_A_LARGE_SITE = 72
TEN_SECONDS = 10.0


@pytest.fixture
def field(tmp_path):
    return Field(tmp_path)


def access(field: Field) -> dict:
    return access_control(field.keys, field.site.members())


def deploy(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "fleetpose.deploy", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def modes(folder: Path) -> dict[str, int]:
    return {
        str(path.relative_to(folder)): stat.S_IMODE(path.stat().st_mode)
        for path in folder.rglob("*")
    }


def test_a_site_with_72_robots_is_made_in_seconds_and_no_file_is_readable_by_others(tmp_path):
    began = time.monotonic()
    keeper, _, seconds = make_site(tmp_path / "s", Site(site="demo", routers={"a": "10.0.0.1"}))
    written = keeper.add("robot", [f"r{n}" for n in range(1, ROBOTS_OF_A_LARGE_SITE + 1)])
    assert seconds < time.monotonic() - began < TEN_SECONDS
    assert len(written.bundles) == ROBOTS_OF_A_LARGE_SITE
    bundles = list((tmp_path / "s/bundles").iterdir())
    assert len(bundles) == ROBOTS_OF_A_LARGE_SITE + 3, "and server, router, health"
    assert (tmp_path / "s").stat().st_mode & 0o777 == 0o700
    assert all(not mode & 0o077 for mode in modes(tmp_path / "s").values())
    keys = {unpacked(path.read_bytes(), str(path))["key.pem"] for path in bundles}
    assert len(keys) == len(bundles), "each has its own"


def test_init_prints_how_long_it_took_and_what_comes_next(tmp_path):
    done = deploy("init", tmp_path / "s", "--site", "hall", "--router", "a=10.0.0.1")
    assert done.returncode == 0, done.stderr
    first = done.stdout.splitlines()[0]
    assert first.startswith("site hall: CA ") and " s; next: pose-deploy add " in first
    assert float(first.split("router(s), ")[1].split(" s;")[0]) < TEN_SECONDS


def test_what_site_toml_says_is_read_as_it_was_written(field):
    again = SiteFolder(field.keeper.folder.path)
    assert again.site == field.site
    field.keeper.revoke(field.site.member("robot/r2"))
    assert SiteFolder(field.keeper.folder.path).site.member("robot/r2").generation == 2


def test_rates_that_are_edited_reach_the_routers_and_no_more_changes(field):
    path = field.keeper.folder.path / "site.toml"
    path.write_text(path.read_text().replace("odometry_hz = 60.0", "odometry_hz = 7.0"))
    done = deploy("rules", field.keeper.folder.path)
    assert "pose-deploy install" in done.stdout, done.stderr
    told = json.loads(field.keeper.folder.rules("a").read_text())
    rates = {rule["key_expr"]: rule["freq"] for rule in told["downsampling"][0]["rules"]}
    assert rates[field.keys.odometry("*")] == 7.0
    assert deploy("rules", field.keeper.folder.path).stdout == "the rules are as they were\n"


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('site = "demo"', 'site = "Demo!"', "site"),
        ('robots = ["r1"', 'robots = ["R1"', "robots.0"),
        ("odometry_hz = 60.0", "odometry_hz = -1", "odometry_hz"),
        ("[generations]", '[generations]\n"r9" = 2', "generations: 'r9' is nobody"),
        ("[routers]", "[routers", "line"),
        ("[rates]", "colour = 1\n[rates]", "colour"),
        ('"127.0.0.1:', '"127.0.0.1:x', "no address"),
    ],
)
def test_what_site_toml_cannot_say_is_named_with_its_place(field, before, after, said):
    path = field.keeper.folder.path / "site.toml"
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, after, 1))
    with pytest.raises(SiteError, match=said) as refused:
        SiteFolder(field.keeper.folder.path)
    assert "\n" not in str(refused.value)


def test_a_folder_that_others_can_read_is_refused_until_it_is_closed(field):
    field.keeper.folder.path.chmod(0o755)
    with pytest.raises(SiteError, match="chmod 700"):
        SiteFolder(field.keeper.folder.path)


def test_a_folder_with_something_in_it_is_not_overwritten(field):
    with pytest.raises(SiteError, match="not empty"):
        make_site(field.keeper.folder.path, field.site)


def test_names_are_given_once(field):
    with pytest.raises(SiteError, match="robot/r1 is there already"):
        field.keeper.add("robot", ["r9", "r1"])
    assert "r9" not in SiteFolder(field.keeper.folder.path).site.robots, "nothing of it is done"


def test_adding_a_robot_gives_the_router_rules_and_takes_nothing_from_others(field):
    before, others = access(field), hash_of(field.site)
    written = field.keeper.add("robot", ["r4"])
    assert written.rules == ["a"] and hash_of(field.site) != others
    after = access(field)
    cloud = field.keys.cloud
    assert not explain(before, Identity("robot", "r4"), "put", cloud("r4")).allowed
    assert explain(after, Identity("robot", "r4"), "put", cloud("r4")).allowed
    for name in ("r1", "r2"):
        who = Identity("robot", name)
        assert set(mine(before, who)) == set(mine(after, who))


def mine(rules: dict, who: Identity) -> list[str]:
    return [expression for _, expression in allowing(rules, who.common_name, INGRESS, PUT)]


def test_a_routers_bundle_always_holds_the_newest_rules(field):
    field.keeper.add("robot", ["r4"])
    bundle = read_bundle(field.bundle("router/a"), no_password)
    assert bundle.files["zenoh.json5"].decode() == field.keeper.folder.rules("a").read_text()
    assert "robot/r4" in bundle.files["zenoh.json5"].decode()


def test_a_revoked_certificate_is_in_no_rule_and_the_next_one_is_another(field):
    old = field.site.member("robot/r2")
    assert field.keeper.revoke(old).rules == ["a"]
    assert not field.keeper.folder.bundle(old).exists()
    assert mine(access(field), old) == []
    new = field.site.member("robot/r2")
    assert new.common_name == "robot/r2#2" and mine(access(field), new)
    [bundle] = field.keeper.renew([new]).bundles
    certificate = certificate_in(bundle.path)
    [name] = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert name.value == "robot/r2#2"


def certificate_in(path: Path) -> x509.Certificate:
    pem = unpacked(path.read_bytes(), str(path))["cert.pem"]
    return x509.load_pem_x509_certificate(pem)


@pytest.mark.parametrize("revoked", [False, True])
def test_a_name_that_was_removed_and_comes_back_never_gives_an_old_certificate_rules(
    field, revoked
):
    old = field.site.member("robot/r2")
    if revoked:
        field.keeper.revoke(old)
    field.keeper.folder.save(field.site.model_copy(update={"robots": ("r1", "r3")}))
    keeper = Keeper(SiteFolder(field.keeper.folder.path))
    keeper.add("robot", ["r2"])
    rules = access_control(field.keys, keeper.folder.site.members())
    assert keeper.folder.site.member("robot/r2").generation == 2
    assert mine(rules, old) == [] and mine(rules, old.of_generation(2))


def test_a_router_that_was_written_into_site_toml_is_told_to_need_a_certificate(field):
    path = field.keeper.folder.path / "site.toml"
    path.write_text(path.read_text().replace("[routers]", '[routers]\n"b" = "10.0.0.2"'))
    site = field.keeper.folder.path
    done = deploy("rules", site)
    assert f"router/b has no certificate: pose-deploy renew {site} router/b" in done.stdout
    assert deploy("renew", site, "router/b").returncode == 0
    assert "no certificate" not in deploy("rules", site).stdout


@pytest.mark.parametrize(
    ("host", "public"),
    [
        *(("10.0.0.1", False), ("fd00::1", False), ("router-a", False)),
        *(("a.hall.internal", False), ("a.example.com", True), ("example.org", True)),
    ],
)
def test_names_that_the_public_web_can_sign_for_are_told(host, public):
    assert is_public(host) is public


def test_who_trusts_a_revoked_router_is_told(field):
    """Clients do not read rules: to them a router's certificate holds until it ends."""
    done = deploy("revoke", field.keeper.folder.path, "router/a")
    assert done.returncode == 0 and "go on trusting its old certificate until" in done.stdout
    assert "trusting" not in deploy("revoke", field.keeper.folder.path, "robot/r1").stdout


def test_renewing_keeps_the_name_and_changes_key_and_certificate_but_no_rule(field):
    who = field.site.member("robot/r1")
    before = certificate_in(field.bundle("robot/r1"))
    written = field.keeper.renew([who], days=30)
    after = certificate_in(field.bundle("robot/r1"))
    assert written.rules == []
    assert before.subject == after.subject and before.serial_number != after.serial_number
    assert before.public_key() != after.public_key()
    ends = after.not_valid_after_utc - datetime.now(UTC)
    assert timedelta(days=29) < ends <= timedelta(days=30)


def test_who_expires_soon_is_found_and_who_was_revoked_must_be_named(field):
    assert field.keeper.expiring(30) == []
    field.keeper.renew([field.site.member("robot/r3")], days=5)
    assert field.keeper.expiring(30) == [field.site.member("robot/r3")]
    field.keeper.revoke(field.site.member("robot/r3"))
    assert field.keeper.expiring(30) == []
    assert field.keeper.without_certificate() == [field.site.member("robot/r3")]


def test_certificates_say_what_they_are_for(field):
    client, router = (certificate_in(field.bundle(who)) for who in ("robot/r1", "router/a"))

    def usages(certificate: x509.Certificate) -> set[str]:
        told = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        return {usage._name for usage in told}

    assert usages(client) == {"clientAuth"} and usages(router) == {"clientAuth", "serverAuth"}
    for certificate in (client, router):
        told = certificate.extensions.get_extension_for_class(x509.BasicConstraints)
        assert told.critical and not told.value.ca
        ca = x509.load_pem_x509_certificate(field.keeper.folder.authority().pem)
        certificate.verify_directly_issued_by(ca)


def request(key: ec.EllipticCurvePrivateKey, name: str) -> bytes:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = x509.CertificateSigningRequestBuilder().subject_name(subject)
    return builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def test_a_machine_may_keep_its_key_and_does_not_choose_its_name(field):
    key = ec.generate_private_key(ec.SECP256R1())
    [bundle] = field.keeper.add("robot", ["r4"], request=request(key, "server")).bundles
    assert "key.pem" not in unpacked(bundle.path.read_bytes(), "it")
    certificate = certificate_in(bundle.path)
    assert certificate.public_key() == key.public_key()
    [name] = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert name.value == "robot/r4"


def test_a_damaged_request_or_one_for_several_is_refused(field):
    good = request(ec.generate_private_key(ec.SECP256R1()), "x")
    with pytest.raises(SiteError, match="damaged"):
        field.keeper.add("robot", ["r4"], request=good[:100])
    with pytest.raises(SiteError, match="one machine"):
        field.keeper.add("robot", ["r5", "r6"], request=good)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("10.0.0.1", "10.0.0.1", 7447),
        ("a.internal:7448", "a.internal", 7448),
        ("[fd00::1]:7448", "fd00::1", 7448),
        ("fd00::1", "fd00::1", 7447),
    ],
)
def test_addresses_of_routers(text, host, port):
    address = router_address("a", text)
    assert (address.host, address.port) == (host, port)
    assert address.endpoint == f"tls/{f'[{host}]' if ':' in host else host}:{port}"


@pytest.mark.parametrize("text", ["", "a:99999", "a:b", "a b", "a/b:1"])
def test_no_address_is_named(text):
    with pytest.raises(SiteError, match="no address"):
        router_address("a", text)


def test_show_tells_everybody_until_when_and_who_was_revoked(field):
    field.keeper.revoke(field.site.member("robot/r2"))
    done = deploy("show", field.keeper.folder.path)
    lines = {line.split()[0]: line for line in done.stdout.splitlines()}
    assert set(lines) >= {who.who for who in field.site.members()}
    assert "revoked, not renewed" in lines["robot/r2"] and "generation 2" in lines["robot/r2"]
    assert "90 days" in lines["robot/r1"] and "generation 1" in lines["robot/r1"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("add", "nowhere", "robot", "r1"), "no site's folder"),
        (("init", "s", "--router", "10.0.0.1"), "NAME=HOST"),
        (("init", "s", "--router", "a=10.0.0.1", "--site", "A B"), "is no name"),
        (("revoke", "{site}", "robot/r9"), "has no robot/r9"),
        (("revoke", "{site}", "r1"), "write e.g. robot/r1"),
        (("add", "{site}", "robot", "R 1"), "is no name"),
        (("rules", "{site}", "--explain", "robot/r1", "shout", "x"), "nothing that can be done"),
        (("rules", "{site}", "--explain", "robot/r1", "put", "a//b"), "is no key"),
        (("rules", "{site}", "--check", "z"), "has no router 'z'"),
        (("rules", "{site}", "--check", "a"), "nothing listens"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_code_2(field, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    done = deploy(*(part.format(site=field.keeper.folder.path) for part in arguments))
    assert done.returncode == 2, done.stdout
    assert said in done.stderr and done.stderr.count("\n") == 1, done.stderr


def test_explain_says_which_rule_or_what_else_is_allowed(field):
    site = field.keeper.folder.path
    yes = deploy("rules", site, "--explain", "robot/r2", "put", "robot/r2/cloud")
    assert yes.returncode == 0 and "rule robot-ingress-put-" in yes.stdout
    no = deploy("rules", site, "--explain", "robot/r2", "put", "robot/r1/cloud")
    assert no.returncode == 1 and "only fleet/demo/robot/r2/camera" in no.stdout
    old = deploy("rules", site, "--explain", "robot/r2#7", "put", "robot/r2/cloud")
    assert old.returncode == 1 and "may put nothing at all" in old.stdout
