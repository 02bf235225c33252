"""How much memory a piece of work takes at its peak, also in libraries that are not Python's."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"  # of Linux, see proc(5)


@dataclass
class Peak:
    """Resident memory of this process, MB.

    Attributes:
        peak_mb: at the peak of the work; none where the system does not tell.
        added_mb: beyond what there was before it.
    """

    peak_mb: float | None = None
    added_mb: float | None = None


@contextmanager
def peak_memory() -> Iterator[Peak]:
    """Notes the peak of what is done inside."""
    peak = Peak()
    try:
        _CLEAR.write_text(_RESET_PEAK)
        before_mb = _mb("VmRSS")
    except OSError:  # another system, or it is not allowed
        yield peak
        return
    yield peak
    peak.peak_mb = _mb("VmHWM")
    peak.added_mb = peak.peak_mb - before_mb


def _mb(what: str) -> float:
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith(what))
    return int(line.split()[1]) / 1024.0
