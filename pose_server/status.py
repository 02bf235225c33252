"""How the server is doing: load, queue and drops, as it is published."""

import resource
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version

from pose_server.pairs.workers import Engine
from pose_server.publish import Stamp
from pose_server.site import Site
from protocol.messages import ServerStatus

_DROPS = ("without_token", "worker_died")  # counted by the site


@dataclass(frozen=True)
class Load:
    """When counting began: the server's monotonic clock, and what start-up had cost it."""

    began_s: float
    startup_cpu_s: float = field(default_factory=lambda: _cpu_s())


def server_status(
    site: Site, engine: Engine, load: Load, stamp: Stamp, drops: Mapping[str, int]
) -> ServerStatus:
    """The status now.

    Args:
        drops: what was refused or replaced before it reached the site, by reason.
    """
    uptime = stamp.now_s - load.began_s
    counts = site.counts
    views = counts.get("views", 0)
    newer = drops.get("newer_view", 0) + counts.get("views_overtaken", 0)
    return ServerStatus(
        server_epoch=stamp.epoch,
        uptime_s=uptime,
        views=views,
        alignments=counts.get("alignments", 0),
        solves=counts.get("solves", 0),
        pending_jobs=engine.running,
        workers=engine.workers,
        pairs_per_s=counts.get("alignments", 0) / max(uptime, 1e-3),
        other_cpu_ms_per_view=1e3 * (_cpu_s() - load.startup_cpu_s) / max(views, 1),
        max_pair_wait_s=site.agenda.max_wait_s,
        drops={
            **drops,
            **{name: counts[name] for name in _DROPS if name in counts},
            "newer_view": newer,
        },
        version=version("fleetpose"),
    )


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
