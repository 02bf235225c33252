"""`pose-eval neighbours`: does the server's index of keyframes find, among those of a thousand
robots, the ones that see the same, and how long does that take?

Robots stand on rings in as many synthetic towns as they fill, each town with textures of its own.
They show up in any order. Each is laid beside those before it, as the server does: the index names
so many that look alike, and the true neighbours among those before it are counted. Beside it stands
the comparison with every one of them, as smaller fleets have it.
"""

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.mapping.memory import peak_memory
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.options.fleets import NeighboursOptions
from fleetpose.evaluation.report.output import output_folder, print_table, write_csv, write_summary
from fleetpose.evaluation.simulate.world import RingWorld
from fleetpose.pose_server.retrieval.view_index import ViewIndex
from fleetpose.pose_server.scheduling.proposals import MOST_ALIKE
from fleetpose.pose_server.state.views import KeptView, likeness, open_view
from fleetpose.pose_server.workers.run import use_one_thread
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import new_epoch
from fleetpose.protocol.messages import View, ViewName
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.robot_agent.features.packing import view_of

TRUE_DEG = 30.0  # two views of the middle of a square so far apart see much of the same
_COMPARED = 20  # robots whose view is compared with that of every other, for the time it takes
COLUMNS = ("robot", "town", "azimuth_deg", "neighbours", "found", "index_ms")


@dataclass(frozen=True)
class Stand:
    """A robot's place, and its view as the server keeps it."""

    town: int
    azimuth_deg: float
    view: KeptView


def run(options: NeighboursOptions, out: Path) -> dict[str, Any]:
    """Makes the views, asks the index; writes neighbours.csv and summary.json.

    Raises:
        FleetPoseError: the folder cannot be made.
    """
    output_folder(out)
    robots = range(options.robots)
    with bench_of(options.workers) as bench:
        jobs = [(k, (_stand, options, k)) for k in robots]
        stands = list(bench.by_label("views", jobs).values())
    use_one_thread()
    order = np.random.default_rng(options.seed).permutation(options.robots)
    with peak_memory() as peak:
        rows = _asked([stands[k] for k in order])
    neighbours, found = (sum(row[c] for row in rows) for c in ("neighbours", "found"))
    summary = {
        "robots": options.robots,
        "towns": len({one.town for one in stands}),
        "true_neighbours": neighbours,
        "found_share": found / neighbours if neighbours else float("nan"),
        "index_ms_p50": percentile([row["index_ms"] for row in rows], 50),
        "index_ms_p95": percentile([row["index_ms"] for row in rows], 95),
        "index_ms_max": max(row["index_ms"] for row in rows),
        "all_compared_ms": _all_compared_ms(stands),
        "index_mb": peak.added_mb,
    }
    write_csv(out / "neighbours.csv", COLUMNS, rows)
    write_summary(out, summary)
    print_table("true neighbours among the most alike", ("", "value"), list(summary.items()))
    return summary


def _stand(options: NeighboursOptions, k: int) -> Stand:
    """A robot's view of its town; runs in a worker."""
    town, place = divmod(k, options.town)
    world, matcher = _town(options.town, options.seed + town)
    shot = world.shoot(place)
    frame = matcher.frame(shot.left, shot.right, 0)
    name = ViewName(robot=f"r{k}", epoch=new_epoch(), seq=0)
    payload = pack(view_of(name, frame, salient_of(frame)))
    x, y = shot.T_world_robot[:2, 3]
    azimuth_deg = float(np.degrees(np.arctan2(y, x)))
    return Stand(town, azimuth_deg, open_view(payload, encoding_of(View), 0.0))


@lru_cache(maxsize=1)
def _town(robots: int, seed: int) -> tuple[RingWorld, StereoMatcher]:
    world = RingWorld(robots, 360.0 / robots, seed=seed)
    return world, StereoMatcher(world.rig)


def _asked(stands: list[Stand]) -> list[dict[str, Any]]:
    """What the index finds of each robot's neighbours when its view comes after those before."""
    index, rows = ViewIndex(), []
    for n, one in enumerate(stands):
        began = time.perf_counter()
        alike = index.most_alike(one.view.signature)
        index.add(one.view.name, one.view.signature)
        index_ms = 1e3 * (time.perf_counter() - began)
        near = {other.view.name for other in stands[:n] if _are_neighbours(one, other)}
        rows.append(
            {
                "robot": one.view.name.robot,
                "town": one.town,
                "azimuth_deg": one.azimuth_deg,
                "neighbours": len(near),
                "found": len(near & set(alike[:MOST_ALIKE])),
                "index_ms": index_ms,
            }
        )
    return rows


def _are_neighbours(one: Stand, other: Stand) -> bool:
    apart = abs((one.azimuth_deg - other.azimuth_deg + 180.0) % 360.0 - 180.0)
    return one.town == other.town and apart <= TRUE_DEG + 1e-6


def _all_compared_ms(stands: list[Stand]) -> float:
    """What comparing a view with all others takes, ms: the median of some."""
    took_ms = []
    for one in stands[:_COMPARED]:
        began = time.perf_counter()
        for other in stands:
            likeness(one.view, other.view)
        took_ms.append(1e3 * (time.perf_counter() - began))
    return float(np.median(took_ms))
