"""The commands of a site's keeper: init, add, renew, revoke, rules, show."""

import getpass
import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fleetpose.deploy.errors import BundleError, SiteError
from fleetpose.protocol.commands import examples

if TYPE_CHECKING:
    from fleetpose.deploy.sealing import Sealer
    from fleetpose.deploy.site.issuing import Keeper, Written

PASSWORD = "FLEETPOSE_BUNDLE_PASSWORD"

PRIVATE_ENDINGS = ("internal", "local", "lan", "home", "test")

SitePath = Annotated[Path, typer.Argument(metavar="SITE", help="The site's folder.")]
Days = Annotated[float, typer.Option(min=0.01, max=3650, help="Days that certificates hold.")]
Password = Annotated[
    bool,
    typer.Option(
        "--password",
        help=f"Put bundles under a password: asked for, or ${PASSWORD}.",
    ),
]


def init(
    folder: SitePath,
    router: Annotated[
        list[str],
        typer.Option(metavar="NAME=HOST[:PORT]", help="A router, repeatable. a=10.0.0.1"),
    ],
    site: Annotated[str, typer.Option(help="The site's name, in all keys.")] = "demo",
    password: Password = False,
) -> None:
    """Make a site's folder and first bundles.

    It holds the certificate authority, and the bundles of the server and the routers. Keep the
    folder where no robot reaches it, and a copy of it: whoever has ca/ca.key can make anybody.
    HOST is the name or address at which robots and operators reach a router.
    """
    from fleetpose.deploy.site.folder import Site
    from fleetpose.deploy.site.issuing import make_site
    from fleetpose.protocol.keys import checked_name

    routers = dict(_router(text) for text in router)
    told = Site(site=checked_name(site), routers=routers)
    keeper, written, seconds = make_site(folder, told, _sealer(password))
    print(
        f"site {site}: CA {keeper.fingerprint[:8]}, {len(routers)} router(s), {seconds:.2f} s; "
        f"next: pose-deploy add {folder} robot NAME..."
    )
    for address in told.addresses():
        if is_public(address.host):
            print(
                f"{address.host} is a name of the public web, whose authorities zenoh trusts as "
                "well: better an address, or a name under .internal"
            )
    _say(keeper, written)


def add(
    folder: SitePath,
    role: Annotated[
        Literal["robot", "operator", "observer", "recorder"], typer.Argument(metavar="ROLE")
    ],
    names: Annotated[list[str], typer.Argument(metavar="NAME")],
    days: Days = 90.0,
    request: Annotated[
        Path | None,
        typer.Option(help="Signing request (PEM) of a machine that keeps its key to itself."),
    ] = None,
    password: Password = False,
) -> None:
    """Give robots, operators, observers or recorders their bundles.

    The routers' rules change with it. An operator clicks; an observer may only look; a recorder
    hears all that is said, for `pose-server record` and `show --live`.
    """
    keeper = _keeper(folder, password)
    asked = None if request is None else _content(request)
    _say(keeper, keeper.add(role, names, days, asked))


def renew(
    folder: SitePath,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="WHO", help="e.g. robot/r1, server, router/a")
    ] = None,
    within: Annotated[
        float, typer.Option(min=0, help="Without names: whose certificate ends in so many days.")
    ] = 30.0,
    days: Days = 90.0,
    password: Password = False,
) -> None:
    """Make new certificates before old ones end.

    Keys are new, names stay. Install them where the old ones are: nothing is restarted but routers.
    """
    keeper = _keeper(folder, password)
    who = [keeper.folder.site.member(name) for name in names or ()]
    if not names:
        who = keeper.expiring(within)
        if not who:
            print(f"nobody's certificate ends within {within:g} days")
    _say(keeper, keeper.renew(who, days))


def revoke(
    folder: SitePath, who: Annotated[str, typer.Argument(metavar="WHO", help="e.g. robot/r2")]
) -> None:
    """Make somebody's certificate worthless.

    Rules name its next generation from now on. It counts as soon as the routers run the new
    rules. 'pose-deploy renew SITE WHO' gives a new bundle. To remove somebody for good, take
    the name out of site.toml and run 'pose-deploy rules'.
    """
    keeper = _keeper(folder)
    before = keeper.folder.site.member(who)
    record = keeper.folder.newest().get(before.common_name)
    written = keeper.revoke(before)
    now = keeper.folder.site.member(who)
    print(
        f"{now.who}: only generation {now.generation} counts once the routers run their new rules"
    )
    if now.role == "router" and record is not None:
        print(
            "robots and operators go on trusting its old certificate until "
            f"{record.not_after:%Y-%m-%d}: give the router another address in site.toml and renew "
            "all bundles, or make the site anew"
        )
    _say(keeper, written)


def rules(
    folder: SitePath,
    explain: Annotated[
        tuple[str, str, str] | None,
        typer.Option(
            metavar="WHO VERB KEY",
            help="Why somebody may put, delete, subscribe, hear, ask, answer, show or see a key.",
        ),
    ] = None,
    check: Annotated[
        str | None, typer.Option(metavar="ROUTER", help="Does that router run these rules?")
    ] = None,
) -> None:
    """Write, explain or compare the routers' rules.

    Without options they are written anew, after site.toml was edited. With --explain or --check
    nothing is written; 0 says yes, 1 no.
    """
    keeper = _keeper(folder)
    if explain is not None:
        raise typer.Exit(_explain(keeper, *explain))
    if check is not None:
        raise typer.Exit(_compare(keeper, check))
    from fleetpose.deploy.site.issuing import Written

    changed = keeper.write_rules()
    if not changed:
        print("the rules are as they were")
    for who in keeper.without_certificate():
        print(f"{who.who} has no certificate: pose-deploy renew {folder} {who.who}")
    _say(keeper, Written(rules=changed))


def show(folder: SitePath) -> None:
    """Show who belongs to the site, and until when."""
    keeper = _keeper(folder)
    newest, now = keeper.folder.newest(), datetime.now(UTC)
    for router in keeper.folder.site.addresses():
        print(f"router {router.name} is reached at {router.host}:{router.port}")
    for who in keeper.folder.site.members():
        record = newest.get(who.common_name)
        until = "revoked, not renewed" if record is None else f"until {record.not_after:%Y-%m-%d}"
        left = "" if record is None else f"{record.days_left(now):5.0f} days"
        print(f"{who.who:24}{until:22}{left:12}generation {who.generation}")


def _router(text: str) -> tuple[str, str]:
    name, equals, address = text.partition("=")
    if not (name and equals and address):
        raise SiteError(f"--router '{text}': write NAME=HOST[:PORT], e.g. a=10.0.0.1")
    from fleetpose.protocol.keys import checked_name

    return checked_name(name), address


def is_public(host: str) -> bool:
    """Whether some authority of the web may sign for a host: it is a name with a public ending."""
    return (
        "." in host
        and host.rpartition(".")[2].lower() not in PRIVATE_ENDINGS
        and (not host.replace(".", "").isdigit() and ":" not in host)
    )


def _keeper(folder: Path, password: bool = False) -> "Keeper":
    from fleetpose.deploy.site.folder import SiteFolder
    from fleetpose.deploy.site.issuing import Keeper

    return Keeper(SiteFolder(folder), _sealer(password))


def _sealer(asked: bool) -> "Sealer | None":
    from fleetpose.deploy.sealing import Sealer

    return Sealer(new_password()) if asked else None


def new_password() -> str:
    """From the environment, or typed twice.

    Raises:
        BundleError: the two differ.
    """
    if PASSWORD in os.environ:
        return os.environ[PASSWORD]
    first = getpass.getpass("password of the bundles: ")
    if getpass.getpass("the same again: ") != first:
        raise BundleError("the two passwords differ: type the same twice")
    return first


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SiteError(f"--request {path}: {error.strerror}") from error


def _say(keeper: "Keeper", written: "Written") -> None:
    """What was written, and what is to be done with it."""
    for bundle in written.bundles:
        print(bundle)
    routers = [keeper.folder.rules(name) for name in written.rules]
    if any(bundle.who.role == "router" for bundle in written.bundles):
        return  # their bundles hold the rules
    if routers:
        print("routers must be restarted, one after the other: their rules changed. On each:")
        for path in routers:
            print(f"  pose-deploy install {path} && systemctl restart fleetpose-{path.stem}")


def _explain(keeper: "Keeper", name: str, verb: str, key: str) -> int:
    from fleetpose.deploy.identity import Identity
    from fleetpose.deploy.site.explain import explain
    from fleetpose.deploy.site.rules import access_control

    site = keeper.folder.site
    asked = Identity.parse(name)
    who = asked if asked.generation > 1 else site.member(name)
    whole = key if key.startswith(("fleet/", "@", "*")) else f"{site.keys.root}/{key}"
    explained = explain(access_control(site.keys, site.members()), who, verb, whole)
    print(explained.text)
    return 0 if explained.allowed else 1


def _compare(keeper: "Keeper", name: str) -> int:
    """Asks a router which rules it runs, by the keeper's own certificate."""
    from fleetpose.deploy.machine.asking import rules_of_router
    from fleetpose.deploy.site.folder import HEALTH
    from fleetpose.deploy.site.issuing import hash_of

    bundle = keeper.folder.bundle(keeper.folder.site.member(HEALTH.who))
    running = rules_of_router(bundle, name, ask_password)
    should = hash_of(keeper.folder.site)
    same = running == should
    print(
        f"router {name} runs the rules of this folder ({should})"
        if same
        else f"router {name} runs other rules ({running}) than those of this folder ({should}): "
        f"pose-deploy install {keeper.folder.rules(name)} there, and restart it"
    )
    return 0 if same else 1


def ask_password() -> str:
    """Of a bundle that exists: from the environment, or typed."""
    return os.environ.get(PASSWORD) or getpass.getpass("password of the bundle: ")


EXAMPLES: dict[Callable[..., None], tuple[str, ...]] = {
    init: ("pose-deploy init hall --router a=10.0.0.1 --site hall",),
    add: ("pose-deploy add hall robot r1 r2 r3", "pose-deploy add hall operator kim"),
    renew: ("pose-deploy renew hall --within 30", "pose-deploy renew hall robot/r1"),
    revoke: ("pose-deploy revoke hall robot/r2",),
    rules: ("pose-deploy rules hall --explain robot/r1 put robot/r2/view",),
    show: ("pose-deploy show hall",),
}


def register(app: typer.Typer) -> None:
    """Adds the commands to a program."""
    for command, lines in EXAMPLES.items():
        app.command(epilog=examples(*lines))(command)
