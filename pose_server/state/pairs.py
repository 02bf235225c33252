"""What was done between two robots."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar

import numpy as np

from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.protocol.keys import RobotPair
from fleetpose.protocol.messages import ViewName

ViewPair = tuple[ViewName, ViewName]
Due = Literal["nothing", "clicks", "search"]
Work = Literal["clicks", "features"]  # what a worker asks: clicks alone are quick
_MOST_UNTRIED = 8  # keyframe pairs of two robots that wait at a time
_BY_VERDICT = {"verified": 3, "plausible": 2, "ambiguous": 1, "rejected": 0}


@dataclass(frozen=True)
class PairStatus:
    """What is done with a pair now, and what is to be done when that has ended.

    Attributes:
        at_work: what workers do with it. Changed clicks do not wait for features.
        due: its clicks changed and were not aligned since; or they were, without asking features
            again, and nothing sure was found.
        overtaken: clicks have been aligned since features were asked, which know less than these.
    """

    at_work: frozenset[Work] = frozenset()
    due: Due = "nothing"
    overtaken: bool = False

    @property
    def running(self) -> bool:
        """Whether a worker aligns it."""
        return bool(self.at_work)


@dataclass
class Agenda:
    """Which pairs are at work, due and tried: of a large fleet's 100 000 pairs few are, and they
    are asked for at every turn.

    Attributes:
        running: workers align them.
        clicks: changed and not being aligned, in the order in which they became so.
        search: due for that and not at work, likewise.
        tried: that were aligned at least once.
    """

    running: set[RobotPair] = field(default_factory=set)
    clicks: dict[RobotPair, None] = field(default_factory=dict)
    search: dict[RobotPair, None] = field(default_factory=dict)
    tried: dict[RobotPair, None] = field(default_factory=dict)

    def note(self, pair: RobotPair, status: PairStatus) -> None:
        """What a pair is at now."""
        (self.running.add if status.running else self.running.discard)(pair)
        _list(self.clicks, pair, status.due == "clicks" and "clicks" not in status.at_work)
        _list(self.search, pair, status.due == "search" and not status.running)


def _list(pairs: dict[RobotPair, None], pair: RobotPair, listed: bool) -> None:
    if listed:
        pairs.setdefault(pair)
    else:
        pairs.pop(pair, None)


@dataclass
class PairRecord:
    """What was done between two robots (or between segments of one).

    Attributes:
        pair, agenda: where it notes what it is at; none of a record that stands alone.
        status: whether it is at work, and what is due.
        untried: what the most promising keyframe pairs promise that were not aligned yet, 0 to 1.
        tried: keyframe pairs aligned, and by which kinds of starts.
        searched: what features gave for keyframe pairs.
        search_from_s: features are not asked beside clicks before.
        retry: views that are tried again, since the last alignment failed and one of both robots
            sees something else now; retry_promise: as in untried.
        failures: alignments in a row that were rejected, or ended without a result.
        heard: which correspondences, by id and revision, the images were asked about last, and
            whether they are believed.
        clicks_grave: probability that the pose of those is gravely off.
        told: what operators were told about them.
        contradicted: what they are told where the solution contradicts those that are believed.
        last: the newest alignment, its views and when it ended: this is what is told of the pair.
        refuted: a solution set a verified edge of the pair aside since then.
        best: by verdict, then inliers: what the pair queue and the questions go by.
    """

    pair: RobotPair | None = None
    agenda: Agenda | None = field(default=None, repr=False)
    status: PairStatus = PairStatus()
    untried: dict[ViewPair, float] = field(default_factory=dict)
    tried: dict[ViewPair, set[str]] = field(default_factory=dict)
    searched: dict[ViewPair, PairResult] = field(default_factory=dict)
    search_from_s: float = -np.inf
    retry: ViewPair | None = None
    retry_promise: float = 0.0
    failures: int = 0
    heard: dict[tuple[int, int], bool] = field(default_factory=dict)
    clicks_grave: float = 1.0
    told: str = ""
    contradicted: str = ""
    last: PairResult | None = None
    refuted: bool = False
    last_views: ViewPair | None = None
    last_s: float = -np.inf
    best: PairResult | None = None
    best_views: ViewPair | None = None
    alignments: int = 0

    @property
    def running(self) -> bool:
        """Whether a worker aligns it."""
        return self.status.running

    @property
    def clicks_due(self) -> bool:
        """Whether its clicks changed and were not aligned since."""
        return self.status.due == "clicks"

    @property
    def overtaken(self) -> bool:
        """Whether clicks have been aligned since features were asked, which are still at work."""
        return self.status.overtaken

    def make_due(self, due: Due) -> None:
        """What is to be done next; nothing comes before changed clicks."""
        self._turn_to(replace(self.status, due=due))

    def search_later(self, from_s: float) -> None:
        """Features are to be asked beside the clicks, from a time on."""
        self.search_from_s = from_s
        self.make_due("search")

    def start(self, work: Work = "features") -> None:
        """A worker begins to align it."""
        overtakes = work == "clicks" and "features" in self.status.at_work
        at_work = self.status.at_work | {work}
        self._turn_to(replace(self.status, at_work=at_work, overtaken=overtakes or self.overtaken))

    def stop(
        self, result: PairResult, views: ViewPair, now_s: float, work: Work = "features"
    ) -> None:
        """A worker has ended, with a result or a failure."""
        self._end(work)
        self._note_tried()
        self.alignments += 1
        self.last, self.last_views, self.last_s = result, views, now_s
        self.refuted = False
        self.failures = self.failures + 1 if result.verdict == "rejected" else 0

    def stop_overtaken(self, views: ViewPair, by_features_alone: PairResult | None) -> None:
        """Features have answered that clicks overtook: their result is not the pair's, but the
        next alignment by clicks may know it.
        """
        self._end("features")
        if by_features_alone is not None:
            self.searched[views] = by_features_alone

    def learn(
        self, result: PairResult, views: ViewPair, kind: str, by_features_alone: bool
    ) -> None:
        """Files the result of keyframes: verdict first, then inliers decide whether it is the
        best.
        """
        self.note_tried(views, kind)
        if by_features_alone:
            self.searched[views] = result
        if self.best is None or _worth(result) >= _worth(self.best):
            self.best, self.best_views = result, views

    def note_tried(self, views: ViewPair, kind: str) -> None:
        """Two keyframes were aligned, by that kind of starts."""
        self.tried.setdefault(views, set()).add(kind)
        self._note_tried()

    def propose(self, views: ViewPair, promise: float) -> None:
        """Two keyframes may be worth aligning; the most promising few wait."""
        self.untried[views] = promise
        if len(self.untried) > _MOST_UNTRIED:
            del self.untried[min(self.untried, key=lambda one: self.untried[one])]

    def withdraw(self, views: Collection[ViewPair]) -> None:
        """Keyframes that are not worth aligning any more."""
        self.untried = {at: promise for at, promise in self.untried.items() if at not in views}

    def propose_again(self, views: ViewPair, promise: float) -> None:
        """Views that are worth another try after a failure."""
        self.retry, self.retry_promise = views, promise

    def take(self, views: ViewPair) -> None:
        """Views whose turn it is; what fails once more asks for another."""
        self.untried.pop(views, None)
        self.retry = None

    def hear(self, heard: Mapping[tuple[int, int], bool], p_grave: float, told: str) -> bool:
        """What the images said of the operator's correspondences; whether operators are to be told
        something new.
        """
        new = bool(told) and told != self.told
        self.heard, self.clicks_grave, self.told = dict(heard), p_grave, told
        return new

    def contradict(self, told: str) -> bool:
        """What the solution says against them, if anything; whether that is new."""
        new = bool(told) and told != self.contradicted
        self.contradicted = told
        return new

    def refute(self) -> None:
        """A solution set a verified edge of the pair aside."""
        self.refuted = True

    def forget(self, view: ViewName) -> None:
        """A keyframe is not kept any more."""
        self.untried = _without(view, self.untried)
        self.tried = _without(view, self.tried)
        self.searched = _without(view, self.searched)

    def _end(self, work: Work) -> None:
        overtaken = self.overtaken and work != "features"
        at_work = self.status.at_work - {work}
        self._turn_to(replace(self.status, at_work=at_work, overtaken=overtaken))

    def _turn_to(self, status: PairStatus) -> None:
        self.status = status
        if self.agenda is not None and self.pair is not None:
            self.agenda.note(self.pair, status)

    def _note_tried(self) -> None:
        if self.agenda is not None and self.pair is not None:
            self.agenda.tried.setdefault(self.pair)


def _worth(result: PairResult) -> tuple[int, int]:
    return _BY_VERDICT[result.verdict], result.inliers


V = TypeVar("V")


def _without(view: ViewName, by_views: dict[ViewPair, V]) -> dict[ViewPair, V]:
    return {views: value for views, value in by_views.items() if view not in views}
