"""`pose-server`: runs the server of a site, or a router."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from protocol.errors import FleetPoseError

app = typer.Typer(
    help="Knows where the robots of a site are relative to each other, and tells them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


@app.command()
def run(
    site: Annotated[
        str | None, typer.Option(help="Name of the site, a chunk of every key.")
    ] = None,
    listen: Annotated[
        list[str] | None, typer.Option(help="Be the router as well, e.g. tcp/0.0.0.0:7447.")
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Router to connect to, e.g. tcp/127.0.0.1:7447.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="zenoh configuration (JSON5) instead.")
    ] = None,
    state_dir: Annotated[Path | None, typer.Option(help="Folder of the journal.")] = None,
    workers: Annotated[int | None, typer.Option(help="Alignment processes.")] = None,
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler to align on, e.g. tcp://10.0.0.1:8786.")
    ] = None,
    skip_pairs: Annotated[
        Path | None, typer.Option(help="Lines 'r1 r2': pairs left to the operator.")
    ] = None,
    anchor: Annotated[str | None, typer.Option(help="Robot at the fleet's origin.")] = None,
    metrics: Annotated[
        str | None, typer.Option(help="Serve the status to Prometheus at HOST:PORT.")
    ] = None,
    takeover: Annotated[
        bool | None,
        typer.Option("--takeover", help="Start even if another server of the site is alive."),
    ] = None,
    dump_config: Annotated[bool, typer.Option(help="Print the settings and end.")] = False,
) -> None:
    """Runs the pose server. With neither --listen nor --connect it is its own router on port
    7447.
    """
    from pose_server.settings import ServerSettings

    given = {
        k: v
        for k, v in locals().items()
        if k not in ("ServerSettings", "dump_config") and v is not None
    }
    if not (listen or connect or config):
        given["listen"] = ["tcp/127.0.0.1:7447"]
    settings = ServerSettings(**given)
    if dump_config:
        print(settings.model_dump_json(indent=2))
        return
    from pose_server.build import build
    from pose_server.process import serve

    serve(lambda: build(settings))


@app.command()
def router(
    listen: Annotated[
        list[str] | None,
        typer.Option(help="Endpoint, repeatable. [default: tcp/127.0.0.1:7447]"),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="zenoh configuration (JSON5) of a router instead, e.g. with TLS."),
    ] = None,
) -> None:
    """Runs a zenoh router without a pose server.

    On a machine that others connect to: --listen tcp/0.0.0.0:7447. It then lets in everybody who
    reaches it, unencrypted, unless a configuration says otherwise.
    """
    from pose_server.router import route

    route(tuple(listen or ["tcp/127.0.0.1:7447"]), config)


def main() -> None:
    """Entry point: says what to install or to mend instead of a traceback."""
    try:
        app()
    except ModuleNotFoundError as error:
        sys.exit(f"pose-server needs '{error.name}': pip install 'fleetpose[server]'")
    except FleetPoseError as error:
        print(f"pose-server: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
