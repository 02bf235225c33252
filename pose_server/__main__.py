"""`pose-server`: runs the server of a site, or a router."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from fleetpose.pose_server.recording import commands as recording
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.commands import Version, command_line, examples, require, run_command
from fleetpose.protocol.settings import DumpSettings, SettingsFile, with_options

if TYPE_CHECKING:
    from fleetpose.pose_server.mapping.files import MapFiles
    from fleetpose.pose_server.mapping.scene import Scene

T = TypeVar("T")

app = command_line()

app.add_typer(recording.app)


@app.callback()
def _server(version: Version = False) -> None:
    """Knows where the robots of a site are relative to each other, and tells them."""


@app.command(
    epilog=examples(
        "pose-server run --listen tcp/0.0.0.0:7447 --state-dir hall",
        "pose-server run --connect tcp/192.168.1.10:7447 --workers 4",
    )
)
@with_options(ServerSettings)
def run(
    *,
    settings: SettingsFile = None,
    dump_settings: DumpSettings = False,
    **given: Any,
) -> None:
    """Runs the pose server. With neither --listen nor --connect it is its own router on port
    7447.

    Every setting can also be given as FLEETPOSE_SERVER_<NAME> in the environment, or in a file.
    """
    loaded = ServerSettings.load(settings, given)
    if not (loaded.listen or loaded.connect or loaded.config):
        loaded = loaded.model_copy(update={"listen": ("tcp/127.0.0.1:7447",)})
    if dump_settings:
        print(loaded.as_toml(), end="")
        return
    require("server" + ",cluster" * bool(loaded.cluster) + ",metrics" * bool(loaded.metrics))
    from fleetpose.pose_server.workers import preload

    preload.use_one_thread()
    if not loaded.cluster:
        preload.start()  # before what takes seconds to import
    from fleetpose.pose_server.app.build import build
    from fleetpose.pose_server.app.process import serve

    serve(lambda stopped: build(loaded, stopped))


@app.command(epilog=examples("pose-server router --listen tcp/0.0.0.0:7447"))
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
    from fleetpose.pose_server.routing.router import route

    route(tuple(listen or ["tcp/127.0.0.1:7447"]), config)


StateDir = Annotated[Path, typer.Option(help="Folder of the server's journal.")]


@app.command(
    "export",
    epilog=examples(
        "pose-server export --out session --state-dir hall",
        "pose-server export --map fleet.ply --picture fleet.png",
    ),
)
def export_session(
    out: Annotated[Path | None, typer.Option(help="Folder to make, for the session.")] = None,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="PLY file to write: the clouds of all located robots."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Picture of these with cameras, links and errors: png, pdf, svg, jpg."),
    ] = None,
    voxel_m: Annotated[
        float | None,
        typer.Option(
            help="Edge of the map's voxels, metres; if not told, half the cameras' depth sigma at "
            "the scene's depth, at least two pixels."
        ),
    ] = None,
    formats: Annotated[
        str,
        typer.Option(help="What --out holds beside correspondences, e.g. tum,g2o,colmap."),
    ] = "tum,g2o",
    state_dir: StateDir = Path("fleetpose-state"),
) -> None:
    """Writes what a server knows as files. The server may be running.

    --out: the operators' correspondences (JSON, CSV, with the images they were clicked in), and by
    --formats: tum, kitti (where robots were in every view that was followed), g2o (the pose graph,
    one for the fleet), colmap, bundler, nvm (the views that the server keeps, with their points)
    and ply (the map). OUT/README.txt says what is what. Look at trajectories with `evo_traj tum
    OUT/tum/*/*.tum`.

    --map, --picture: the fleet in 3D, in the frame of the fleet: the clouds of the keyframes of
    all located robots. Each robot has one colour, and in the PLY file a number (`robot`, names in
    its header). Points whose depth is known worse than to 5 % of the scene's depth are left out.
    """
    from fleetpose.pose_server.mapping.files import MapFiles
    from fleetpose.pose_server.persistence.export import export

    files = MapFiles(map_file, picture, voxel_m)
    wanted = tuple(name for name in formats.replace(" ", "").split(",") if name)
    written = export(state_dir, out, files, lambda views: _watched(views, "views"), wanted)
    if written.scene is not None:
        _say_map(files, written.scene)
    if out is not None:
        print(
            f"{out}: {written.correspondences} correspondences with {written.views} views; "
            f"{written.followed} views placed, {written.keyframes} of them keyframes, "
            f"{written.components} components"
        )


def _watched(items: Sequence[T], what: str) -> Iterable[T]:
    """Goes through them with a progress bar on standard error, if that is a terminal."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    return track(items, what, console=console, transient=True, disable=not console.is_terminal)


def _say_map(files: "MapFiles", scene: "Scene") -> None:
    made = scene.fleet_map
    written = ", ".join(str(file) for file in (files.cloud, files.picture) if file is not None)
    print(
        f"{written}: {len(made.points)} points of {len(made.robots)} robots, voxels of "
        f"{made.voxel_m:.3g} m"
    )
    if scene.missing:
        print(f"not located, and not in the map: {', '.join(scene.missing)}")


@app.command("import", epilog=examples("pose-server import session --state-dir hall"))
def import_session(
    files: Annotated[
        list[Path], typer.Argument(help="JSON or CSV files, or folders that `export` made.")
    ],
    state_dir: StateDir = Path("fleetpose-state"),
) -> None:
    """Takes correspondences from files into the journal of a server that does not run.

    Each is checked as if it were clicked now: the pixels must have depth, the views must be in the
    journal or in the folder `views` beside the file. What is there already is skipped. Ends with 1
    if anything was refused, and says what and why.
    """
    from fleetpose.pose_server.persistence.importing import import_files

    found = import_files(state_dir, files)
    for place, reason in found.refused:
        print(f"{place}: {reason}", file=sys.stderr)
    print(
        f"{found.accepted} correspondences taken, {found.duplicates} were there already, "
        f"{len(found.refused)} refused"
    )
    raise typer.Exit(1 if found.refused else 0)


def main() -> None:
    """Runs the command line; what a user can mend is one sentence and exit code 2."""
    run_command(app, "pose-server", "server")


if __name__ == "__main__":
    main()
