"""`pose-deploy`: a fleet in the field, or all of it on this machine."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fleetpose.deploy import machine_commands, site_commands
from fleetpose.protocol.commands import Version, command_line, examples, require, run_command

app = command_line()
site_commands.register(app)
machine_commands.register(app)


@app.callback()
def _commands(version: Version = False) -> None:
    """Put a fleet into the field.

    On the keeper's machine: init a site, add robots and operators. On theirs: install the bundle,
    check the link.
    """


@app.command(
    epilog=examples(
        "pose-deploy local --robots r1=rgbd:recordings/kitchen \\",
        "    --robots r2=rgbd:recordings/hall",
    )
)
def local(
    robots: Annotated[
        list[str],
        typer.Option(
            help="NAME=CAMERA:DATA, once per robot, e.g. r1=rgbd:recordings/kitchen",
            metavar="ROBOT",
        ),
    ],
    site: Annotated[str, typer.Option(help="Site in all keys.")] = "demo",
    rate: Annotated[
        float, typer.Option(min=0.01, max=100, help="Views per second of each robot.")
    ] = 1.0,
    replay: Annotated[
        Literal["once", "loop", "pingpong", "hold"],
        typer.Option(help="In which order a recording is shown; hold: its first view for ever."),
    ] = "pingpong",
    workers: Annotated[
        int, typer.Option(min=1, max=256, help="Alignment processes of the server.")
    ] = 2,
    directory: Annotated[
        Path, typer.Option(help="For logs and the server's state.", file_okay=False)
    ] = Path("fleet"),
) -> None:
    """Run a whole fleet on this machine until Ctrl-C."""
    from fleetpose.deploy.local_fleet import LocalFleet, wait_running

    require("robot,server")
    sources = [robot_source(text) for text in robots]
    with LocalFleet(directory, site) as fleet:
        fleet.start_router()
        fleet.start_server("--workers", str(workers))
        for name, camera, data in sources:
            fleet.start_robot(name, camera, data, "--rate", str(rate), "--replay", replay)
        robots_text = "1 robot" if len(sources) == 1 else f"{len(sources)} robots"
        print(f"{robots_text}, logs in {directory}. Ctrl-C ends all. To watch:")
        print(f"  hmi-client screen --connect {fleet.endpoint} --site {site}", flush=True)
        wait_running(fleet, lambda: False, float("inf"))


def robot_source(text: str) -> tuple[str, str, str]:
    """Name, camera and data of `NAME=CAMERA:DATA`.

    Raises:
        NameRefusedError: it is not of that form.
    """
    from fleetpose.protocol.errors import NameRefusedError
    from fleetpose.protocol.keys import checked_name

    name, equals, source = text.partition("=")
    camera, colon, data = source.partition(":")
    if not (equals and colon and camera and data):
        raise NameRefusedError(f"--robots '{text}': write NAME=CAMERA:DATA, e.g. r1=rgbd:kitchen")
    return checked_name(name), camera, data


def main() -> None:
    """Runs the command line; what a user can mend is one sentence and exit code 2."""
    run_command(app, "pose-deploy", "robot,server")


if __name__ == "__main__":
    main()
