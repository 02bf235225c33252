"""`pose-eval map`: poses and map agree. A fleet on consecutive views of a recording is put together
by the server's own jobs and solver, its map is merged by the server's own code, and laid beside the
truth.

Compared are, in the world, with the anchor's camera where it truly is:

- what poses do: how far each point of each cloud lies from where the true pose of its camera puts
  it. It is that point's own shift, so no nearest neighbour makes it smaller;
- the map and the true cloud: from every point of the map to the nearest true point (accuracy), and
  from every true point to the nearest of the map (completeness). The true cloud is that of `sparse`
  at true poses: it has no noise of the robots' own clouds in it. Where a recording has none, as of
  a depth camera, it is the robots' own clouds at true poses, and that is said;
- the same of a map of the same clouds at the true poses: what their noise alone makes, and how far
  apart true points are. No poses are better than that.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.mapping.compare import Distances, Shift, compared, moved_by_poses
from fleetpose.evaluation.bench.mapping.memory import Peak, peak_memory
from fleetpose.evaluation.bench.mapping.truth import at_true_poses, true_cloud, world_from_fleet
from fleetpose.evaluation.bench.offline.fleet import MOST_JOBS_PER_PAIR, remembering
from fleetpose.evaluation.bench.offline.server import OfflineServer
from fleetpose.evaluation.bench.pairs.worker import timed
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m, open_recording
from fleetpose.evaluation.data.parts import parts_of
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.options.recorded import MapOptions
from fleetpose.evaluation.report.output import output_folder, print_table, write_summary
from fleetpose.pose_server.geometry.se3 import transform
from fleetpose.pose_server.mapping.files import MapFiles
from fleetpose.pose_server.mapping.located import located_views, map_of, map_of_views
from fleetpose.pose_server.mapping.merging import FleetMap


def run(options: MapOptions, out: Path) -> dict[str, Any]:
    """Puts a fleet together, merges its map, compares; writes map.ply, map.png and summary.json.

    Raises:
        FleetPoseError: the data cannot be used, or no robot is located.
    """
    files = MapFiles(out / "map.ply", out / "map.png", options.voxel_m)
    files.check()
    recording = open_recording(options.data, options.clouds)
    parts = parts_of(recording, options.robots, options.first)
    output_folder(out)
    server = _put_together(recording, [part[0] for part in parts], options.workers)
    true = {name: recording.view(index) for name, index in server.views.items()}
    server.poses()  # which says who is located
    with peak_memory() as peak:
        scene, merge_ms = timed(lambda: map_of(server.site, server.settings, options.voxel_m))
    files.write(scene)
    summary = _summary(recording, server, true, scene.fleet_map)
    summary |= {
        "data": str(options.data),
        "clouds": recording.clouds,
        "robots": options.robots,
        "located": len(scene.cameras),
        "missing": list(scene.missing),
        "median_depth_m": median_depth_m(recording),
        "merge_ms": merge_ms,
        **asdict(peak),
    }
    write_summary(out, summary)
    _say(summary, peak)
    return summary


def _put_together(recording: Recording, views: list[TrueView], workers: int) -> OfflineServer:
    """A server that has aligned and solved all there was."""
    pairs = len(views) * (len(views) - 1) // 2
    with bench_of(workers) as bench:
        wires, _ = bench.on_the_wire(recording, views, seed=0)
        bar = bench.progress.add_task("alignments, some more than once", total=pairs)
        align = remembering(bench.folder)

        def counted(job: Any) -> Any:
            bench.progress.advance(bar)
            return align(job)

        server = OfflineServer(wires, counted)
        server.settle(MOST_JOBS_PER_PAIR * max(pairs, 1))
    return server


def _summary(
    recording: Recording, server: OfflineServer, true: dict[str, TrueView], made: FleetMap
) -> dict[str, Any]:
    """The figures of the comparison, metres."""
    views = located_views(server.site, server.settings)
    T_world_fleet = world_from_fleet(views, true, server.site.anchor)
    truth = true_cloud(recording, [true[name] for name in made.robots], views, true)
    righted = at_true_poses(views, true, T_world_fleet)
    by_noise = map_of_views(righted, made.robots, server.site.depth_m, made.voxel_m)
    return {
        "points": len(made.points),
        "voxel_m": made.voxel_m,
        "true_points": len(truth.points),
        "true_cloud": truth.what,
        "poses": asdict(moved_by_poses(views, righted)),
        "map": asdict(compared(transform(T_world_fleet, made.points), truth.points)),
        "noise_alone": asdict(compared(transform(T_world_fleet, by_noise.points), truth.points)),
    }


def _say(summary: dict[str, Any], peak: Peak) -> None:
    shift, own = Shift(**summary["poses"]), Distances(**summary["map"])
    noise = Distances(**summary["noise_alone"])
    print(
        f"{summary['located']} of {summary['robots']} robots located; map: {summary['points']} "
        f"points; truth: {summary['true_points']} points, {summary['true_cloud']}"
    )
    print_table(
        "The anchor's camera where it truly is",
        ("", "median, cm", "p95, cm"),
        (
            ("shift of a point by its camera's pose", *_cm(shift.median_m, shift.p95_m)),
            ("map to truth", *_cm(own.accuracy_median_m, own.accuracy_p95_m)),
            (
                "  by noise alone, poses true",
                *_cm(noise.accuracy_median_m, noise.accuracy_p95_m),
            ),
            ("truth to map", *_cm(own.completeness_median_m, own.completeness_p95_m)),
            (
                "  by noise alone, poses true",
                *_cm(noise.completeness_median_m, noise.completeness_p95_m),
            ),
        ),
    )
    added = "" if peak.added_mb is None else f", {peak.added_mb:.0f} MB more at its peak"
    print(f"merged in {summary['merge_ms']:.0f} ms{added}")


def _cm(*metres: float) -> tuple[float, ...]:
    return tuple(100.0 * value for value in metres)
