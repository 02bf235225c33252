"""Memory of a fleet's processes, noted every second."""

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet

_MB = 1024.0 * 1024.0


@dataclass
class Memory:
    """Resident memory in MB: the largest agent, and the server with its workers, over time."""

    agents_mb: list[float] = field(default_factory=list)
    server_mb: list[tuple[float, float]] = field(default_factory=list)

    def note(self, fleet: LocalFleet, robots: Sequence[str]) -> None:
        """Notes what the processes use now."""
        self.agents_mb.append(max(resident_mb(fleet.pid(robot)) for robot in robots))
        self.server_mb.append((time.monotonic(), resident_mb(fleet.pid("server"))))

    def agent_peak_mb(self) -> float | None:
        return max(self.agents_mb, default=None)

    def server_peak_mb(self) -> float | None:
        return max((mb for _, mb in self.server_mb), default=None)

    def server_slope_mb_per_min(self) -> float | None:
        """Of a line through the second half of the notes, when all caches are warm."""
        later = np.array(self.server_mb[len(self.server_mb) // 2 :])
        if len(later) < 3:
            return None
        return float(60.0 * np.polyfit(later[:, 0] - later[0, 0], later[:, 1], 1)[0])


def resident_mb(pid: int) -> float:
    """Of a process and all processes under it; 0 for one that is gone."""
    return sum(family_mb(pid).values())


def family_mb(pid: int) -> dict[int, float]:
    """Of a process and of each process under it, by their ids; those that are gone, or end while
    they are looked at, are left out.
    """
    import psutil

    found = {}
    with suppress(psutil.Error):
        process = psutil.Process(pid)
        for member in (process, *process.children(recursive=True)):
            with suppress(psutil.Error):
                found[member.pid] = member.memory_info().rss / _MB
    return found
