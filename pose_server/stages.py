"""How long the stages of the server's work take: medians of the last times."""

import time
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median

_LAST = 100


@dataclass
class Stages:
    """The last times of each stage, in milliseconds."""

    _times: defaultdict[str, deque[float]] = field(
        default_factory=lambda: defaultdict(lambda: deque(maxlen=_LAST))
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
