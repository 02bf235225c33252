"""The commands of a machine: install, check."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from fleetpose.deploy.errors import BundleError
from fleetpose.protocol.commands import examples

Root = Annotated[Path, typer.Option(help="Folder of all that is installed.")]


def install(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A bundle (*.fleetpose), or a router's new rules."),
    ],
    root: Root = Path("/etc/fleetpose"),
    systemd: Annotated[bool, typer.Option("--systemd", help="Write systemd units.")] = False,
    compose: Annotated[bool, typer.Option("--compose", help="Write a compose file.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Write nothing, say what.")] = False,
    image: Annotated[
        Path, typer.Option(help="Write into this file system, not the running one.")
    ] = (Path("/")),
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Install a bundle on this machine.

    Its certificate, key and zenoh configuration, and units or a compose file to start it. A
    bundle that is renewed goes to the same place, and nothing is restarted but a router. Prints
    each file, and the two commands that start what was installed.
    """
    from fleetpose.deploy.machine import install as installing
    from fleetpose.deploy.machine.bundle import content_of, read_bundle
    from fleetpose.deploy.machine.system_files import CONTAINER_USER, System
    from fleetpose.deploy.site_commands import ask_password

    if systemd and compose:
        raise BundleError("--systemd and --compose: choose one")
    system = System.SYSTEMD if systemd else System.COMPOSE if compose else None
    if content_of(file).lstrip().startswith(b"{"):
        plan = installing.plan_rules(content_of(file), file, root, image)
    else:
        plan = installing.plan_install(read_bundle(file, ask_password), root, system, image)
    if as_json:
        print(installing.as_json(plan))
    else:
        print(f"{plan.who.who}{': would write' if dry_run else ''}")
        print("\n".join(installing.described(plan)))
    if dry_run:
        return
    try:
        plan.write(owner=CONTAINER_USER if compose else None)
    except OSError as error:
        raise BundleError(
            f"{error.filename}: {error.strerror}: run it as root, or give --root"
        ) from error


def check(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Of one bundle, or of all.")
    ] = Path("/etc/fleetpose"),
    quick: Annotated[bool, typer.Option("--quick", help="Open no session.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check this machine's link to its site.

    One line a step, and what to do where it is not in order. Ends with 0 where all is well,
    with 1 where something will fail soon, with 2 where it fails.
    """
    from fleetpose.deploy.machine.check import check as steps_of
    from fleetpose.deploy.machine.installed import folders_below

    folders = folders_below(folder)
    if not folders:
        raise BundleError(f"{folder} holds no bundle: install one with 'pose-deploy install FILE'")
    worst, report = 0, []
    for one in folders:
        began, steps = time.monotonic(), []
        if not as_json:
            print(one)
        for step in steps_of(one, quick):
            steps.append({"step": step.name, "state": step.state.name.lower(), "text": step.text})
            worst = max(worst, step.state)
            if not as_json:
                print(step, flush=True)
        seconds = round(time.monotonic() - began, 3)
        report.append({"folder": str(one), "steps": steps, "seconds": seconds})
    if as_json:
        print(json.dumps({"exit": int(worst), "folders": report}, indent=1))
    raise typer.Exit(int(worst))


def register(app: typer.Typer) -> None:
    """Adds the commands to a program."""
    app.command(
        epilog=examples(
            "pose-deploy install robot-r1.fleetpose --systemd",
            "pose-deploy install robot-r1.fleetpose --dry-run",
        )
    )(install)
    app.command(epilog=examples("pose-deploy check", "pose-deploy check --quick --json"))(check)
