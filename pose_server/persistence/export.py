"""A session as files, and its map: what `pose-server export` writes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fleetpose.formats.arrays import FormatError
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.mapping.files import MapFiles
from fleetpose.pose_server.mapping.located import Watched, map_of
from fleetpose.pose_server.mapping.scene import Scene
from fleetpose.pose_server.persistence.opening import ExportError, opened_session
from fleetpose.pose_server.persistence.photos import reconstruction_of, write_reconstruction
from fleetpose.pose_server.persistence.placed import placed_views
from fleetpose.pose_server.persistence.table import write_csv, write_json
from fleetpose.pose_server.persistence.trajectories import (
    write_g2o_files,
    write_kitti_files,
    write_tum_files,
)
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.messages import KeptView, View, ViewName

RECONSTRUCTIONS = ("colmap", "bundler", "nvm")
FORMATS = ("tum", "kitti", "g2o", *RECONSTRUCTIONS, "ply")
USUAL = ("tum", "g2o")
VIEWS = "views"
VIEW_ENDING = ".view"
README = """What a fleetpose server knew, as `pose-server export` wrote it. Metres, radians; camera
axes are OpenCV's (x right, y down, z ahead). The fleet frame is that of the anchor's component;
others have their own.

correspondences.json, .csv  points that operators clicked in two images: pixels, and the points in
                            the camera frames of their views
views/                      the views that were clicked in, for `pose-server import`, and images
tum/<component>/            robots' bodies, every followed view: time tx ty tz qx qy qz qw, by the
                            robot's clock
kitti/<component>/          robots' cameras: the upper rows of T_fleet_camera, and times in s
fleet.g2o                   pose graph of the cameras of the anchor's component, its root held still
                            (FIX); g2o/<component>.g2o: the others. Links that were found wrong are
                            left out, clicks between two views are one edge. Information matrices
                            are g2o's own, for translation and half angles: gtsam, which reads whole
                            angles, takes rotations four times too exactly
vertices.csv                which vertex is which view, and on which keyframe it hangs
colmap/                     sparse/0 (binary) and images: the views that the server has points of;
                            points have no colours, images are those that operators clicked in
bundler/, nvm/              the same; these formats know no principal point (nvm does where all
                            cameras share theirs): features count from it
fleet.ply                   the clouds of all located robots
"""


@dataclass(frozen=True)
class Exported:
    """How much was written.

    Attributes:
        views: that were clicked in.
        followed: all views whose poses are known, keyframes among them.
        scene: the map, if one was asked for.
    """

    correspondences: int = 0
    keyframes: int = 0
    links: int = 0
    components: int = 0
    views: int = 0
    followed: int = 0
    scene: Scene | None = None


def export(
    state_dir: Path,
    out: Path | None = None,
    mapped: MapFiles = MapFiles(),  # noqa: B008 (frozen)
    watched: Watched = iter,
    formats: Sequence[str] = USUAL,
) -> Exported:
    """Writes the session of a state folder, its map, or both; its server may be running.

    Nothing is written where a map is asked for that there cannot be.

    Args:
        out: folder for the session.
        mapped: files for the map.
        watched: goes through the views of the map, e.g. with a progress bar.
        formats: of the folder, of `FORMATS`.

    Raises:
        FleetPoseError: there is no session, it cannot be read, no robot is located, or a file or
            the folder not be written.
    """
    if unknown := [name for name in formats if name not in FORMATS]:
        raise ExportError(f"--formats {unknown[0]}: known are {','.join(FORMATS)}")
    if out is not None and "ply" in formats and mapped.cloud is None:
        mapped = replace(mapped, cloud=out / "fleet.ply")
    mapped.check()
    if out is None and not mapped.wanted:
        raise ExportError("say what to write: --out FOLDER, --map FILE.ply or --picture FILE.png")
    with opened_session(state_dir) as (site, journal):
        scene = None
        if mapped.wanted:
            settings = ServerSettings.model_validate({})
            scene = map_of(site, settings, mapped.voxel_m, watched)
            mapped.write(scene)
        if out is None:
            return Exported(scene=scene)
        try:
            return replace(_written(site, journal, out, formats), scene=scene)
        except OSError as error:
            raise ExportError(f"--out {out}: {error.strerror or error}") from error
        except FormatError as error:
            raise ExportError(str(error)) from error


def _written(site: Site, journal: Journal, out: Path, formats: Sequence[str]) -> Exported:
    out.mkdir(parents=True, exist_ok=True)
    (out / "README.txt").write_text(README)
    items = site.correspondences.all()
    write_json(out / "correspondences.json", items, anchor=site.anchor)
    write_csv(out / "correspondences.csv", items)
    views = _write_views(journal, site.correspondences.views(), out / VIEWS)
    placed = placed_views(site)
    if "tum" in formats:
        write_tum_files(placed, out / "tum")
    if "kitti" in formats:
        write_kitti_files(placed, out / "kitti")
    edges = write_g2o_files(site, placed, out) if "g2o" in formats else 0
    if photos := [name for name in formats if name in RECONSTRUCTIONS]:
        model, images = reconstruction_of(site, placed), _images(journal)
        for name in photos:
            write_reconstruction(name, out / name, model, images)
    keyframes = sum(one.is_keyframe for one in placed.values())
    components = len({one.component for one in placed.values()})
    return Exported(len(items), keyframes, edges, components, views, len(placed))


def _images(journal: Journal) -> dict[ViewName, bytes]:
    """The images that the server has, in the resolution of their cameras."""
    return {
        view.name: view.jpeg
        for view in journal.views()
        if view.jpeg is not None and (view.header is None or view.header.scale == 1)
    }


def _write_views(journal: Journal, clicked: set[ViewName], folder: Path) -> int:
    stored = [view for view in journal.views() if view.name in clicked]
    for view in stored:
        folder.mkdir(parents=True, exist_ok=True)
        kept = KeptView(view=unpack(View, view.encoded), jpeg=view.jpeg, image=view.header)
        view_file(folder, view.name).write_bytes(pack(kept))
        if view.jpeg is not None:
            view_file(folder, view.name).with_suffix(".jpg").write_bytes(view.jpeg)
    return len(stored)


def view_file(folder: Path, view: ViewName) -> Path:
    """Where a view is kept in an exported folder."""
    return folder / f"{view.robot}_{view.epoch}_{view.seq}{VIEW_ENDING}"
