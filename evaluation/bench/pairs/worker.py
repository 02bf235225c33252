"""What `pose-eval pairs` runs in its workers: a robot's and the server's share, true overlaps."""

import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.data.opening import points_of
from fleetpose.evaluation.data.recording import TrueView
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import OverlapCloud, overlap

if TYPE_CHECKING:
    from fleetpose.pose_server.geometry.methods import IcpMethod
    from fleetpose.pose_server.registration.prepared_view import PreparedView
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult
    from fleetpose.pose_server.registration.verdict.hearing import Hearing
    from fleetpose.robot_agent.cameras.kinds import CameraKind

CACHED_VIEWS = 64
T = TypeVar("T")


@dataclass(frozen=True)
class Answer:
    """What the server would publish of a pair; nobody here knows the truth. `wide`: whether the
    usual salient points had not settled it; `hearing`: what became of its clicks.
    """

    T_i_j: Floats | None
    covariance: Floats | None
    verdict: str
    reasons: tuple[str, ...]
    start: str
    inliers: int
    align_ms: float
    wide: bool = False
    confirmed: bool = False
    grown: bool = False
    p_grave: float = 1.0
    mirrored: bool = False
    evidence: dict[str, float] = field(default_factory=dict)
    hearing: "Hearing | None" = None


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What a piece of work gives, and its milliseconds."""
    began = time.perf_counter()
    result = work()
    return result, 1e3 * (time.perf_counter() - began)


def use_one_thread() -> None:
    """Called first in every worker: the processes are the parallelism."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    import cv2

    cv2.setNumThreads(1)
    from fleetpose.pose_server.workers import run

    run.use_one_thread()


def encode(
    robot: str, camera: "CameraKind", folder: Path, wire: Path, images: bool = True
) -> float:
    """Does an agent's work for one frame, writes the bytes to a file, returns the milliseconds.
    Without images it has the cloud alone.
    """
    from fleetpose.protocol import codec
    from fleetpose.protocol.keys import new_epoch
    from fleetpose.protocol.messages import View, ViewName
    from fleetpose.robot_agent.cameras.factory import open_camera
    from fleetpose.robot_agent.features.depth_picture import picture_of
    from fleetpose.robot_agent.features.keypoints import salient_of
    from fleetpose.robot_agent.features.packing import view_of
    from fleetpose.robot_agent.recent_views import kept_view

    frame = next(iter(open_camera(camera, str(folder), "once").frames()))
    if not images:
        frame = replace(frame, image=picture_of(frame.ranges, frame.model), has_image=False)
    name = ViewName(robot=robot, epoch=new_epoch(), seq=0)

    def sent() -> tuple[View, bytes]:
        view = view_of(name, frame, salient_of(frame))
        return view, codec.pack(view)

    (view, payload), elapsed_ms = timed(sent)
    wire.write_bytes(payload)
    wire.with_suffix(".kept").write_bytes(codec.pack(kept_view(view, frame.image)))
    return elapsed_ms


def of_wide(wire: Path) -> Path:
    """The file of a view's wide set, beside that of the view."""
    return wire.with_suffix(".wide")


def widen(wire: Path) -> float:
    """Does an agent's work for one view whose wide set is asked for, the first time that it is;
    returns the milliseconds, 0 if it was done before.
    """
    from fleetpose.protocol import codec
    from fleetpose.protocol.messages import KeptView
    from fleetpose.robot_agent.features.affine_keypoints import wide_view

    wide = of_wide(wire)
    if wide.exists():
        return 0.0
    kept = codec.unpack(KeptView, wire.with_suffix(".kept").read_bytes())
    payload, elapsed_ms = timed(lambda: codec.pack(wide_view(kept)))
    mine = wide.with_suffix(f".wide-{os.getpid()}")
    mine.write_bytes(payload)
    mine.replace(wide)
    return elapsed_ms


@lru_cache(maxsize=CACHED_VIEWS)
def prepared(wire: Path) -> tuple["PreparedView", float]:
    """The server's share of one view, and its milliseconds."""
    from fleetpose.pose_server.registration.prepared_view import prepare_view
    from fleetpose.protocol import codec
    from fleetpose.protocol.messages import View

    payload = wire.read_bytes()
    return timed(lambda: prepare_view(codec.unpack(View, payload)))


@lru_cache(maxsize=CACHED_VIEWS)
def widened(wire: Path) -> "PreparedView":
    """The same view with its wide set of salient points, which its robot makes now."""
    from fleetpose.protocol import codec
    from fleetpose.protocol.messages import View

    widen(wire)
    payload = of_wide(wire).read_bytes()
    return prepared(wire)[0].with_salient(codec.unpack(View, payload).salient)


def forget_views() -> None:
    """Views are prepared anew: they were by other numbers."""
    prepared.cache_clear()
    widened.cache_clear()


def prepare_ms(wire: Path) -> float:
    """Milliseconds that the server's share of a view takes."""
    return prepared(wire)[1]


def align(wire_i: Path, wire_j: Path, icp: "IcpMethod" = "gicp", affine: bool = True) -> Answer:
    """Aligns two views, automatic starts only; what is done once per view is not timed.

    Args:
        wire_i, wire_j: what their robots sent.
        icp: how clouds are brought together.
        affine: whether affine keypoints are asked for where the usual ones settle nothing.
    """
    from fleetpose.pose_server.registration.align import align_pair, align_wide, is_settled

    (i, _), (j, _) = prepared(wire_i), prepared(wire_j)
    result, align_ms = timed(lambda: align_pair(i, j, icp=icp))
    if is_settled(result) or not affine:
        return answer_of(result, align_ms)
    wide_i, wide_j = widened(wire_i), widened(wire_j)
    result, wide_ms = timed(lambda: align_wide(wide_i, wide_j, result, icp=icp))
    return answer_of(result, align_ms + wide_ms, wide=True)


def answer_of(result: "PairResult", align_ms: float, wide: bool = False) -> Answer:
    """What the server would publish of a result."""
    return Answer(
        T_i_j=_floats(result.T_i_j),
        covariance=_floats(result.covariance),
        verdict=result.verdict,
        reasons=tuple(result.reasons),
        start=result.start,
        confirmed=result.confirmed,
        grown=result.grown,
        hearing=result.hearing,
        inliers=int(result.inliers),
        align_ms=align_ms,
        wide=wide,
        p_grave=result.p_grave,
        mirrored=result.mirrored,
        evidence=_flat(result.evidence or result.surfaces),
    )


def _flat(evidence: Any) -> dict[str, float]:
    """All numbers of an evidence, those of its parts too."""
    if evidence is None:
        return {}
    numbers: dict[str, float] = {}
    for name, value in asdict(evidence).items():
        numbers |= value if isinstance(value, dict) else {name: value}
    return numbers


def _floats(array: npt.ArrayLike | None) -> Floats | None:
    return None if array is None else np.asarray(array, np.float64)


_overlap_clouds: dict[int, OverlapCloud] = {}  # a worker serves one recording


def true_overlap(i: TrueView, j: TrueView, T_i_j: Floats) -> float:
    """Overlap of two views at their true pose."""
    for view in (i, j):
        if view.index not in _overlap_clouds:
            _overlap_clouds[view.index] = OverlapCloud.of(points_of(view)[1])
    return overlap(_overlap_clouds[i.index], _overlap_clouds[j.index], T_i_j)
