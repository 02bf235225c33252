"""What is noted of a soak every second: robots, waits, and the memory of each process."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from fleetpose.evaluation.metrics.fleet_scoring import is_grave, score_sample
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.system.faults.clicker import Clicker
from fleetpose.evaluation.system.fleet import poses_now
from fleetpose.evaluation.system.memory import family_mb
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.soak.site import SoakSite


@dataclass(frozen=True)
class Second:
    """What was noted at one moment.

    Attributes:
        at_s: since the beginning.
        located, grave: robots that are, and of these that are gravely off.
        view_to_pose_s: the longest wait of a view whose pose came in this second; none without one.
        click_s: the longest wait of a click whose receipt came in this second.
        in_flight: updates of the restless operator without a receipt.
    """

    at_s: float
    located: int
    grave: int
    view_to_pose_s: float | None
    click_s: float | None
    in_flight: int


@dataclass(frozen=True)
class Memory:
    """Of one process at one moment.

    Attributes:
        mb: resident, with all processes under it.
        life: a number that is another one when the process, or one under it, was started anew.
    """

    at_s: float
    process: str
    mb: float
    life: int


class _Since:
    """What a growing list has got since it was asked last."""

    def __init__(self, values: Sequence[float]) -> None:
        self._values, self._told = values, len(values)

    def longest(self) -> float | None:
        new = self._values[self._told :]
        self._told += len(new)
        return max(new, default=None)


@dataclass
class Noting:
    """A thread that notes every second, in a `with`; what goes wrong in it is raised at its end."""

    site: SoakSite
    observer: Observer
    clicker: Clicker
    limits: Limits
    watched: Sequence[str]  # names of processes
    each_second: Callable[[], None]
    seconds: list[Second] = field(default_factory=list)
    memory: list[Memory] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.began_s = time.monotonic()
        self._views = _Since(self.observer.view_to_pose_s)
        self._clicks = _Since(self.clicker.waits_s)
        self._families: dict[str, tuple[frozenset[int], int]] = {}
        self._ended = threading.Event()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="noting", daemon=True)

    def __enter__(self) -> "Noting":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def now_s(self) -> float:
        """Seconds since the beginning."""
        return time.monotonic() - self.began_s

    def is_alive(self) -> bool:
        """Whether it still notes."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            while not self._ended.wait(1.0):
                self._note(self.now_s())
                self.each_second()
        except Exception as error:  # told by whoever waits for the end
            self._failure = error

    def _note(self, at_s: float) -> None:
        state, truth = self.observer.state, self.site.truth
        now = poses_now(self.observer, truth, truth.ahead_ns)
        rows = score_sample(at_s, self.site.robots, now, None if state is None else state.anchor)
        self.seconds.append(
            Second(
                at_s,
                located=sum(row.located for row in rows),
                grave=sum(is_grave(row, self.limits) for row in rows),
                view_to_pose_s=self._views.longest(),
                click_s=self._clicks.longest(),
                in_flight=self.clicker.in_flight(),
            )
        )
        self.memory += [self._memory(at_s, process) for process in self.watched]

    def _memory(self, at_s: float, process: str) -> Memory:
        family = family_mb(self.site.fleet.pid(process))
        before, life = self._families.get(process, (frozenset(family), 0))
        life += before != frozenset(family)
        self._families[process] = frozenset(family), life
        return Memory(at_s, process, sum(family.values()), life)
