"""What was done between two robots."""

from dataclasses import dataclass, field

import numpy as np

from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.protocol.messages import ViewName

ViewPair = tuple[ViewName, ViewName]


@dataclass
class PairRecord:
    """What was done between two robots (or between segments of one).

    Attributes:
        untried: what the most promising keyframe pairs promise that were not aligned yet, 0 to 1.
        tried: keyframe pairs aligned, and by which kinds of starts.
        searched: what features gave for keyframe pairs.
        retry: views that are tried again, since the last alignment failed and one of both robots
            sees something else now; retry_promise: as in untried.
        failures: alignments in a row that were rejected, or ended without a result.
        clicks_due: the operator's set changed and was not aligned since.
        search_due: it was, but without asking features again, and nothing sure was found.
        heard: which correspondences, by id and revision, the images were asked about last, and
            whether they are believed.
        clicks_grave: probability that the pose of those is gravely off.
        told: what operators were told about them.
        contradicted: what they are told where the solution contradicts those that are believed.
        last: the newest alignment, its views and when it ended: this is what is told of the pair.
        refuted: a solution set a verified edge of the pair aside since then.
        best: by verdict, then inliers: what the pair queue and the questions go by.
    """

    untried: dict[ViewPair, float] = field(default_factory=dict)
    tried: dict[ViewPair, set[str]] = field(default_factory=dict)
    searched: dict[ViewPair, PairResult] = field(default_factory=dict)
    retry: ViewPair | None = None
    retry_promise: float = 0.0
    failures: int = 0
    running: bool = False
    clicks_due: bool = False
    search_due: bool = False
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
