"""What is wrong with a bundle is one sentence, and nothing of it is written."""

import gzip
import io
import json
import os
import subprocess
import sys
import tarfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from fleetpose.deploy.archive import LARGEST, packed, unpacked
from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.machine.bundle import read_bundle
from fleetpose.deploy.machine.install import plan_install
from fleetpose.deploy.manifest import MANIFEST
from fleetpose.deploy.private_files import write_file
from fleetpose.deploy.sealing import Sealer, is_sealed
from fleetpose.deploy.site.issuing import Keeper
from tests.deploy.field_makers import Field, no_password

NOT_EVEN_IMPORTED = """
import sys
sys.modules["cryptography"] = None
from fleetpose.deploy.__main__ import main
main()
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    return Field(tmp_path_factory.mktemp("field"))


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    return Field(tmp_path_factory.mktemp("elsewhere"), site="other")


def changed(field: Field, path: Path, **files: bytes | None) -> Path:
    """A copy of robot r1's bundle in which files are others, or missing."""
    known = unpacked(field.bundle("robot/r1").read_bytes(), "it")
    known |= {name.replace("_", "."): content for name, content in files.items()}
    write_file(path, packed({name: text for name, text in known.items() if text is not None}))
    return path


def files_of(field: Field, who: str) -> dict[str, bytes]:
    return unpacked(field.bundle(who).read_bytes(), who)


def refused(path: Path, said: str) -> None:
    with pytest.raises(BundleError, match=said) as error:
        read_bundle(path, no_password)
    assert "\n" not in str(error.value)


def test_every_cut_and_every_flipped_byte_of_a_bundle_is_one_sentence(field, tmp_path):
    whole = field.bundle("robot/r1").read_bytes()
    path = tmp_path / "b.fleetpose"
    cuts = [whole[:n] for n in range(0, len(whole), 97)]
    flips = [
        whole[:n] + bytes([whole[n] ^ 0x55]) + whole[n + 1 :] for n in range(3, len(whole), 61)
    ]
    read = 0
    for content in (*cuts, *flips):
        write_file(path, content)
        try:
            read_bundle(path, no_password)
            read += 1
        except BundleError as error:
            assert "\n" not in str(error)
    assert read <= 2, "bytes of gzip's header that say nothing"


def test_a_file_that_is_no_bundle_is_named(tmp_path):
    path = tmp_path / "b.fleetpose"
    refused(path, "No such file")
    write_file(path, b"hello")
    refused(path, "is damaged")
    refused(tmp_path, "Is a directory")


def test_parts_of_two_bundles_do_not_fit(field, elsewhere, tmp_path):
    path, r2, other = tmp_path / "b", files_of(field, "robot/r2"), files_of(elsewhere, "robot/r1")
    refused(changed(field, path, key_pem=r2["key.pem"]), "key is another one's")
    refused(changed(field, path, cert_pem=r2["cert.pem"]), "cert.pem is not the manifest's")
    refused(changed(field, path, ca_pem=other["ca.pem"]), "ca.pem is not the manifest's")
    refused(changed(field, path, zenoh_json5=r2["zenoh.json5"]), "put together wrongly")
    refused(changed(field, path, zenoh_json5=other["zenoh.json5"]), "put together wrongly")
    refused(changed(field, path, zenoh_json5=b"{"), "is damaged")
    refused(changed(field, path, zenoh_json5=b"{}"), "does not say whose it is")
    refused(changed(field, path, cert_pem=None), "no cert.pem in it")
    refused(changed(field, path, manifest_json=b"{}"), "manifest is damaged")


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("site", "De mo", "site"),
        ("role", "king", "king"),
        ("generation", 0, "generation"),
        ("bundle", 7, "version 7"),
        ("routers", [{"name": "a", "host": "x;y"}], "routers"),
        ("not_after", "soon", "not_after"),
        ("extra", 1, "extra"),
    ],
)
def test_what_a_manifest_cannot_say_is_named(field, tmp_path, name, value, said):
    told = json.loads(files_of(field, "robot/r1")[MANIFEST]) | {name: value}
    path = changed(field, tmp_path / "b", manifest_json=json.dumps(told).encode())
    with pytest.raises(Exception, match=said) as error:
        read_bundle(path, no_password)
    assert "\n" not in str(error.value)


def member(name: str, **more: object) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    for field_name, value in more.items():
        setattr(info, field_name, value)
    return info


@pytest.mark.parametrize(
    "info",
    [
        member("../../etc/passwd", size=3),
        member("/etc/passwd", size=3),
        member("..", type=tarfile.DIRTYPE),
        member("key.pem", type=tarfile.SYMTYPE, linkname="/etc/shadow"),
        member("cert.pem", type=tarfile.LNKTYPE, linkname="../../x"),
        member("zenoh.json5", type=tarfile.FIFOTYPE),
        member("zenoh.json5", type=tarfile.CHRTYPE),
        member("authorized_keys", size=3),
        member("robot-r1/key.pem", size=3),
    ],
    ids=lambda info: f"{info.name}-{info.type.decode()}",
)
def test_members_that_would_escape_make_the_whole_bundle_suspect(field, tmp_path, info):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        for name, content in files_of(field, "robot/r1").items():
            archive.addfile(member(name, size=len(content)), io.BytesIO(content))
        archive.addfile(info, io.BytesIO(b"bad"))
    path = tmp_path / "b"
    write_file(path, gzip.compress(out.getvalue()))
    with pytest.raises(BundleError, match="does not belong in a bundle"):
        read_bundle(path, no_password)


def test_a_bomb_is_not_unpacked(tmp_path):
    path = tmp_path / "b"
    write_file(path, gzip.compress(bytes(LARGEST + 1)))
    refused(path, "unpacks to more than 16 MiB")


def test_a_bundle_that_others_can_read_is_refused_unless_it_is_under_a_password(field, tmp_path):
    path = tmp_path / "b"
    path.write_bytes(field.bundle("robot/r1").read_bytes())
    path.chmod(0o644)
    refused(path, "can be read by others")
    path.write_bytes(Sealer("secret").seal(field.bundle("robot/r1").read_bytes()))
    assert read_bundle(path, lambda: "secret").who.who == "robot/r1"


def test_a_password_opens_its_bundle_and_no_other(field, tmp_path):
    keeper = Keeper(field.keeper.folder, Sealer("correct horse"))
    first, second = keeper.renew(
        [field.site.member(f"operator/{n}") for n in ("anna", "ben")]
    ).bundles
    contents = [one.path.read_bytes() for one in (first, second)]
    assert all(is_sealed(one) for one in contents)
    assert b"PRIVATE KEY" not in contents[0]
    assert read_bundle(first.path, lambda: "correct horse").who.who == "operator/anna"
    for password in ("", "correct hors", "correct horse "):
        with pytest.raises(BundleError, match="password is another one"):
            read_bundle(first.path, lambda said=password: said)
    for n in range(len(contents[0]) - 1, 26, -449):
        write_file(tmp_path / "b", contents[0][:n])
        with pytest.raises(BundleError, match="password is another one, or"):
            read_bundle(tmp_path / "b", lambda: "correct horse")


def test_an_empty_password_is_refused():
    with pytest.raises(BundleError, match="empty password"):
        Sealer("")


def install(field: Field, who: str, root: Path, now: datetime | None = None) -> None:
    plan_install(read_bundle(field.bundle(who), no_password), root, now=now).write()


def test_an_expired_bundle_and_a_clock_a_day_behind_are_told_apart(field, tmp_path):
    now = datetime.now(UTC)
    with pytest.raises(BundleError, match=r"robot/r1 expired on .* ask the site's keeper to renew"):
        install(field, "robot/r1", tmp_path, now + timedelta(days=91))
    with pytest.raises(BundleError, match=r"clock says .*: set the clock"):
        install(field, "robot/r1", tmp_path, now - timedelta(days=1))
    assert list(tmp_path.iterdir()) == []


def test_a_machine_is_of_one_site_and_one_robot(field, elsewhere, tmp_path):
    install(field, "robot/r1", tmp_path)
    with pytest.raises(BundleError, match=r"is of site 'other', this machine of site 'demo'"):
        install(elsewhere, "robot/r1", tmp_path)
    with pytest.raises(BundleError, match=r"is robot r2's, this machine is robot r1"):
        install(field, "robot/r2", tmp_path)
    install(field, "server", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"robot-r1", "server"}


def test_an_older_site_of_the_same_name_is_named(field, tmp_path):
    install(field, "robot/r1", tmp_path / "root")
    with pytest.raises(BundleError, match="an older one of this name"):
        install(Field(tmp_path / "again"), "robot/r1", tmp_path / "root")


def test_an_older_bundle_does_not_replace_a_newer_one(field, tmp_path):
    old = tmp_path / "old"
    write_file(old, field.bundle("robot/r3").read_bytes())
    field.keeper.renew([field.site.member("robot/r3")])
    install(field, "robot/r3", tmp_path / "root")
    with pytest.raises(BundleError, match="the one installed is newer"):
        plan_install(read_bundle(old, no_password), tmp_path / "root")


def run(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_install_and_check_need_no_cryptography_and_the_keepers_commands_name_it(field, tmp_path):
    done = run(NOT_EVEN_IMPORTED, "install", field.bundle("robot/r1"), "--root", tmp_path)
    assert done.returncode == 0, done.stderr
    checked = run(NOT_EVEN_IMPORTED, "check", tmp_path, "--quick", "--json")
    assert json.loads(checked.stdout)["folders"][0]["steps"][0]["state"] == "ok"
    init = run(NOT_EVEN_IMPORTED, "init", tmp_path / "s", "--router", "a=10.0.0.1")
    assert init.returncode == 2
    assert "pip install 'fleetpose[deploy]'" in init.stderr and init.stderr.count("\n") == 1
    sealed = tmp_path / "sealed"
    write_file(sealed, Sealer("secret").seal(field.bundle("robot/r1").read_bytes()))
    os.environ["FLEETPOSE_BUNDLE_PASSWORD"] = "secret"
    try:
        opened = run(NOT_EVEN_IMPORTED, "install", sealed, "--root", tmp_path)
    finally:
        del os.environ["FLEETPOSE_BUNDLE_PASSWORD"]
    assert opened.returncode == 2 and "fleetpose[deploy]" in opened.stderr
