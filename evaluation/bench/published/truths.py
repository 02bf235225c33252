"""True positions by time, as benchmarks of bags tell them: TUM lines, with or without a turn, or
rows with commas as EuRoC and Kimera write them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats, rigid
from fleetpose.formats.arrays import FormatError
from fleetpose.formats.text import lines_of, nanoseconds
from fleetpose.protocol.errors import DataFolderError

FURTHEST_S = 1.5  # between two true positions: an RTK receiver gives one a second
_WHOLE_NS = 10**15  # of a time without a point: nanoseconds since 1970


@dataclass(frozen=True, eq=False)
class TruePositions:
    """Positions (N, 3), m, by their stamps (N,), ns, in order."""

    stamps_ns: np.ndarray
    positions: Floats

    def at(self, stamp_ns: int) -> Floats | None:
        """A pose (4, 4) of the position then, between its neighbours, and no turn; None where
        they are too far apart.
        """
        k = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if k == len(self.stamps_ns) or (k == 0 and self.stamps_ns[0] != stamp_ns):
            return None
        if self.stamps_ns[k] == stamp_ns:
            return rigid(np.eye(3), self.positions[k])
        before, after = int(self.stamps_ns[k - 1]), int(self.stamps_ns[k])
        if after - before > FURTHEST_S * 1e9:
            return None
        share = (stamp_ns - before) / (after - before)
        p = (1 - share) * self.positions[k - 1] + share * self.positions[k]
        return rigid(np.eye(3), p)


def read_truth(path: Path) -> TruePositions:
    """Reads lines `time x y z ...`; words after these are not needed, # begins remarks.

    Raises:
        DataFolderError: it has no such lines.
    """
    found: dict[int, list[float]] = {}
    for number, line in enumerate(lines_of(path), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if len(words) < 4:
            continue
        try:
            at_ns = _stamp_ns(path, words[0])
            found[at_ns] = [float(word) for word in words[1:4]]
        except (ValueError, FormatError) as error:
            if found:
                raise DataFolderError(f"{path}, line {number}: {error}") from error
            continue  # names of columns
    if not found:
        raise DataFolderError(f"{path} has no lines 'time x y z'")
    stamps_ns = np.array(sorted(found), np.int64)
    return TruePositions(stamps_ns, np.array([found[at] for at in stamps_ns.tolist()]))


def _stamp_ns(path: Path, word: str) -> int:
    if word.isdigit() and int(word) > _WHOLE_NS:
        return int(word)
    return nanoseconds(path, word)
