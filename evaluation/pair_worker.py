"""What `pose-eval pairs` runs in its workers: a robot's and the server's share, true overlaps."""

import os
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from evaluation.datasets import TrueView, points_of
from evaluation.geometry import Floats
from evaluation.scoring import OverlapCloud, overlap

if TYPE_CHECKING:
    from pose_server.pairs.judging import PairResult
    from pose_server.pairs.views import PreparedView

CACHED_VIEWS = 64


@dataclass(frozen=True)
class Answer:
    """What the server would publish of a pair; nobody here knows the truth."""

    T_i_j: Floats | None
    covariance: Floats | None
    verdict: str
    reasons: tuple[str, ...]
    start: str
    inliers: int
    align_ms: float


def use_one_thread() -> None:
    """Called first in every worker: the processes are the parallelism."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    import cv2

    cv2.setNumThreads(1)


def encode(robot: str, camera: str, folder: Path, wire: Path) -> float:
    """Does an agent's work for one frame, writes the bytes to a file, returns the milliseconds."""
    from protocol import codec
    from protocol.keys import new_epoch
    from protocol.messages import ViewName
    from robot_agent.cameras.factory import open_camera
    from robot_agent.packing import view_of
    from robot_agent.salient import salient_points

    kind = "views" if camera == "views" else "rgbd"
    frame = next(iter(open_camera(kind, str(folder), "once").frames()))
    began = time.perf_counter()
    salient = salient_points(frame.image, frame.ranges, frame.model)
    name = ViewName(robot=robot, epoch=new_epoch(), seq=0)
    payload = codec.pack(view_of(name, frame, salient))
    elapsed_ms = 1e3 * (time.perf_counter() - began)
    wire.write_bytes(payload)
    return elapsed_ms


@lru_cache(maxsize=CACHED_VIEWS)
def prepared(wire: Path) -> tuple["PreparedView", float]:
    """The server's share of one view, and its milliseconds."""
    from pose_server.pairs.views import prepare_view
    from protocol import codec
    from protocol.messages import View

    payload = wire.read_bytes()
    began = time.perf_counter()
    view = prepare_view(codec.unpack(View, payload))
    return view, 1e3 * (time.perf_counter() - began)


def prepare_ms(wire: Path) -> float:
    """Milliseconds that the server's share of a view takes."""
    return prepared(wire)[1]


def align(wire_i: Path, wire_j: Path) -> Answer:
    """Aligns two views, automatic starts only."""
    from pose_server.pairs.align import align_pair

    (i, _), (j, _) = prepared(wire_i), prepared(wire_j)
    began = time.perf_counter()
    result = align_pair(i, j)
    return answer_of(result, 1e3 * (time.perf_counter() - began))


def answer_of(result: "PairResult", align_ms: float) -> Answer:
    """What the server would publish of a result."""
    return Answer(
        T_i_j=_floats(result.T_i_j),
        covariance=_floats(result.covariance),
        verdict=result.verdict,
        reasons=tuple(result.reasons),
        start=result.start,
        inliers=int(result.inliers),
        align_ms=align_ms,
    )


def _floats(array: npt.ArrayLike | None) -> Floats | None:
    return None if array is None else np.asarray(array, np.float64)


_overlap_clouds: dict[int, OverlapCloud] = {}  # a worker serves one recording


def true_overlap(i: TrueView, j: TrueView, T_i_j: Floats) -> float:
    """Overlap of two views at their true pose."""
    for view in (i, j):
        if view.index not in _overlap_clouds:
            _overlap_clouds[view.index] = OverlapCloud.of(points_of(view)[1])
    return overlap(_overlap_clouds[i.index], _overlap_clouds[j.index], T_i_j)
