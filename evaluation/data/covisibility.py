"""Which robots see the same by the truth: the fleets that a system could put together."""

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import TypeVar

from fleetpose.evaluation.data.opening import points_of
from fleetpose.evaluation.data.recording import Recording, TrueView, shared_tracks
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import OverlapCloud, overlap

TOGETHER_TRACKS, TOGETHER_OVERLAP = 30, 0.2
"""Two views see the same if they share so many tracks, or so much of their dense depth."""

Name = TypeVar("Name")


def paired_up(names: Sequence[Name], see_the_same: Callable[[Name, Name], bool]) -> set[Name]:
    """Those that see the same as at least one other; asks only about pairs that may tell."""
    together: set[Name] = set()
    for a, b in combinations(names, 2):
        if not (a in together and b in together) and see_the_same(a, b):
            together.update((a, b))
    return together


def chained(names: Sequence[Name], see_the_same: Callable[[Name, Name], bool]) -> list[set[Name]]:
    """Groups that a chain of common sights joins."""
    groups: list[set[Name]] = []
    for name in names:
        met = [group for group in groups if any(see_the_same(name, one) for one in group)]
        groups = [group for group in groups if group not in met] + [{name}.union(*met)]
    return groups


class Sights:
    """Tells of recorded views which see the same; what was asked once is remembered."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._clouds: dict[int, OverlapCloud] = {}
        self._known: dict[tuple[int, int], bool] = {}

    @property
    def _dense(self) -> bool:
        return self._recording.is_rgbd or self._recording.clouds == "stereo_dense"

    def same(self, a: TrueView, b: TrueView) -> bool:
        """Whether two views share 30 tracks, or a fifth of their dense depth."""
        pair = (min(a.index, b.index), max(a.index, b.index))
        if pair not in self._known:
            self._known[pair] = self._same(a, b)
        return self._known[pair]

    def groups(self, views: Iterable[TrueView]) -> list[set[int]]:
        """Indices of the views, in groups that a chain of common sights joins."""
        of = {view.index: view for view in views}
        return chained(list(of), lambda a, b: self.same(of[a], of[b]))

    def _same(self, a: TrueView, b: TrueView) -> bool:
        if (shared_tracks(self._recording, a, b) or 0) >= TOGETHER_TRACKS:
            return True
        return self._dense and enough_overlap(self._cloud(a), self._cloud(b), a.T_to(b))

    def _cloud(self, view: TrueView) -> OverlapCloud:
        if view.index not in self._clouds:
            self._clouds[view.index] = OverlapCloud.of(points_of(view)[1])
        return self._clouds[view.index]


def enough_overlap(a: OverlapCloud, b: OverlapCloud, T_a_b: Floats) -> bool:
    """Whether two dense clouds have a fifth in common at their true pose."""
    return overlap(a, b, T_a_b) >= TOGETHER_OVERLAP
