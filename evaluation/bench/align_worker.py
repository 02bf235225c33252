"""What `pose-eval align` runs in its workers: one pair by one method, timed. No truth is here."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fleetpose.evaluation.bench.baselines import PEERS, Peer, PeerMissingError, Sight
from fleetpose.evaluation.bench.pairs.worker import CACHED_VIEWS, of_wide, widen
from fleetpose.evaluation.data.anonymize import StrippedFolder
from fleetpose.evaluation.metrics.geometry import Floats

Result = TypeVar("Result")


@dataclass(frozen=True)
class Timed:
    """One answer. Each method has one run of a pair before the one that counts for it: libraries
    are loaded then, trees are made, and caches filled.

    Attributes:
        T_i_j: (4, 4) camera j in camera i, metres, of the second run; none where there is no
            answer.
        pair_ms: of the second run: the views have been used before.
        pair_cpu_ms: the same, as the time of all cores together: it says what the work costs where
            others share the machine.
        whole_ms: of the first run with all the work on both views.
    """

    T_i_j: Floats | None
    pair_ms: float
    pair_cpu_ms: float
    whole_ms: float


def align_ours(wire_i: Path, wire_j: Path) -> Timed:
    """Aligns two views as the server does; the robots' share of `whole_ms` is added by the caller.

    Views make their search trees when they are first needed: so views that were never aligned
    before are timed from the bytes to the pose, and the same ones once more. Where the usual
    salient points do not settle a pair, `whole_ms` has what their wide sets cost the robots too.
    """
    from fleetpose.pose_server.registration.align import align_pair, align_wide, is_settled
    from fleetpose.pose_server.registration.prepared_view import prepare_view
    from fleetpose.protocol import codec
    from fleetpose.protocol.messages import View

    def view_in(file: Path) -> View:
        return codec.unpack(View, file.read_bytes())

    def usual() -> Any:
        i, j = (prepare_view(view_in(wire)) for wire in (wire_i, wire_j))
        return i, j, align_pair(i, j)

    (i, j, result), whole_ms, _ = _timed(usual)
    result, pair_ms, pair_cpu_ms = _timed(lambda: align_pair(i, j))
    if not is_settled(result):
        robots_ms = sum(_wide_ms(wire) for wire in (wire_i, wire_j))

        def more() -> Any:
            wide_i = i.with_salient(view_in(of_wide(wire_i)).salient)
            wide_j = j.with_salient(view_in(of_wide(wire_j)).salient)
            return wide_i, wide_j, align_wide(wide_i, wide_j, result)

        (wide_i, wide_j, _), more_ms, _ = _timed(more)
        result, wide_ms, wide_cpu_ms = _timed(lambda: align_wide(wide_i, wide_j, result))
        whole_ms += robots_ms + more_ms
        pair_ms, pair_cpu_ms = pair_ms + wide_ms, pair_cpu_ms + wide_cpu_ms
    T_i_j = None if result.T_i_j is None else np.asarray(result.T_i_j, np.float64)
    return Timed(T_i_j, pair_ms, pair_cpu_ms, whole_ms)


@lru_cache(maxsize=2 * CACHED_VIEWS)
def _wide_ms(wire: Path) -> float:
    """Has a view's robot make its wide set; the milliseconds."""
    return widen(wire)


def missing_peers() -> dict[str, str]:
    """Peers that cannot be loaded here, and why."""
    reasons = {}
    for peer in PEERS:
        try:
            peer.load()
        except PeerMissingError as error:
            reasons[peer.name] = str(error)
    return reasons


def align_peers(wire_i: Path, wire_j: Path, scale: float, names: Sequence[str]) -> dict[str, Timed]:
    """Aligns two views by peers.

    Args:
        names: which.
        wire_i, wire_j: what the robots sent; peers get all points of it, and the images.
        scale: what lengths are multiplied with for the peers.
    """
    return {peer.name: _align(peer, wire_i, wire_j, scale) for peer in PEERS if peer.name in names}


def _align(peer: Peer, wire_i: Path, wire_j: Path, scale: float) -> Timed:
    i, i_ms = _prepared(peer.prepare, wire_i, scale)
    j, j_ms = _prepared(peer.prepare, wire_j, scale)
    _, first_ms, _ = _timed(lambda: peer.align(i, j))
    T_i_j, pair_ms, pair_cpu_ms = _timed(lambda: peer.align(i, j))
    T_i_j[:3, 3] /= scale
    answer = T_i_j if np.isfinite(T_i_j).all() else None
    return Timed(answer, pair_ms, pair_cpu_ms, i_ms + j_ms + first_ms)


@lru_cache(maxsize=2 * CACHED_VIEWS)
def _prepared(prepare: Callable[[Sight], Any], wire: Path, scale: float) -> tuple[Any, float]:
    sight = _sight(wire, scale)
    view, view_ms, _ = _timed(lambda: prepare(sight))
    return view, view_ms


def _sight(wire: Path, scale: float) -> Sight:
    """The points that a robot sent, and the image that it had, from its stripped folder beside."""
    from fleetpose.protocol import codec
    from fleetpose.protocol.clouds import points_of
    from fleetpose.protocol.messages import View
    from fleetpose.robot_agent.cameras.factory import open_camera

    folder = StrippedFolder(wire.with_suffix(""), ())
    frame = next(iter(open_camera(folder.camera, str(folder.path), "once").frames()))
    cloud = points_of(codec.unpack(View, wire.read_bytes()))
    return Sight(scale * cloud.xyz, np.asarray(cloud.uv, np.float64), frame.image)


def _timed(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """What a piece of work gives, its milliseconds, and those of all cores together."""
    began, cpu_began = time.perf_counter(), time.process_time()
    result = work()
    ended, cpu_ended = time.perf_counter(), time.process_time()
    return result, 1e3 * (ended - began), 1e3 * (cpu_ended - cpu_began)
