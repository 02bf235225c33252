"""How the server is doing: load, queue, drops and how long its stages take, as it is published."""

import resource
import time
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median

from fleetpose.pose_server.messages.builders import Stamp
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.pools import Engine
from fleetpose.protocol.messages import ServerStatus
from fleetpose.protocol.text import release

_RATE_OVER_S = 10.0
_DROPS = ("without_token", "worker_died")  # counted by the site
_LAST_TIMES = 100  # of a stage, for its median


@dataclass
class Stages:
    """The last times of each stage, in milliseconds."""

    _times: defaultdict[str, deque[float]] = field(
        default_factory=lambda: defaultdict(lambda: deque(maxlen=_LAST_TIMES))
    )

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Notes how long what is done within takes."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._times[stage].append(1e3 * (time.perf_counter() - began))

    def note(self, times_ms: Mapping[str, float]) -> None:
        """Notes times that were taken elsewhere."""
        for stage, ms in times_ms.items():
            self._times[stage].append(ms)

    def medians_ms(self) -> dict[str, float]:
        """By stage."""
        return {stage: median(times) for stage, times in sorted(self._times.items())}


@dataclass(frozen=True)
class Load:
    """When counting began: the server's monotonic clock, and what start-up had cost it."""

    began_s: float
    startup_cpu_s: float = field(default_factory=lambda: _cpu_s())
    _seen: deque[tuple[float, int]] = field(default_factory=deque)

    def rate(self, alignments: int, now_s: float) -> float:
        """Alignments per second over the last ten seconds."""
        self._seen.append((now_s, alignments))
        while len(self._seen) > 2 and now_s - self._seen[0][0] > _RATE_OVER_S:
            self._seen.popleft()
        since_s, before = self._seen[0] if len(self._seen) > 1 else (self.began_s, 0)
        return (alignments - before) / max(now_s - since_s, 1e-3)


def server_status(
    site: Site,
    engine: Engine,
    load: Load,
    stages: Stages,
    stamp: Stamp,
    drops: Mapping[str, int],
) -> ServerStatus:
    """The status now.

    Args:
        stages: times of what is done.
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
        pairs_per_s=load.rate(counts.get("alignments", 0), stamp.now_s),
        other_cpu_ms_per_view=1e3 * (_cpu_s() - load.startup_cpu_s) / max(views, 1),
        max_pair_wait_s=site.pair_queue.max_wait_s,
        drops={
            **drops,
            **{name: counts[name] for name in _DROPS if name in counts},
            "newer_view": newer,
        },
        version=release(),
        waiting=_waiting(site),
        wait_share=site.pair_queue.max_wait_share,
        stage_ms=stages.medians_ms(),
        picked=site.pair_queue.picked,
        denied=site.denials.denied,
        refused=site.denials.refused,
    )


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _waiting(site: Site) -> dict[str, int]:
    return {
        **{line: len(turns) for line, turns in site.pair_queue.lines.items()},
        "clicks": len(site.agenda.clicks),
        "search": len(site.agenda.search),
        "compare": len(site.pair_queue.to_compare),
        "follow": sum(robot.waiting is not None for robot in site.robots.values()),
    }
