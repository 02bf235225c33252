"""What `pose-eval align` runs in its workers: one pair by one method, timed. No truth is here."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from evaluation.geometry import Floats
from evaluation.pair_worker import CACHED_VIEWS
from evaluation.peers import PEERS, Peer

Result = TypeVar("Result")


@dataclass(frozen=True)
class Timed:
    """One answer.

    Attributes:
        T_i_j: (4, 4) camera j in camera i, metres; none where there is no answer.
        pair_ms: of a pair whose views have been used before.
        pair_cpu_ms: the same, as the time of all cores together: it says what the work costs where
            others share the machine.
        whole_ms: of the same pair with all the work on both views.
    """

    T_i_j: Floats | None
    pair_ms: float
    pair_cpu_ms: float
    whole_ms: float


def align_ours(wire_i: Path, wire_j: Path) -> Timed:
    """Aligns two views as the server does; the robots' share of `whole_ms` is added by the caller.

    Views make their search trees when they are first needed: so views that were never aligned
    before are timed from the bytes to the pose, and the same ones once more.
    """
    from pose_server.pairs.align import align_pair
    from pose_server.pairs.views import prepare_view
    from protocol import codec
    from protocol.messages import View

    payloads = wire_i.read_bytes(), wire_j.read_bytes()

    def whole() -> Any:
        i, j = (prepare_view(codec.unpack(View, payload)) for payload in payloads)
        return i, j, align_pair(i, j)

    (i, j, _), whole_ms, _ = _timed(whole)
    result, pair_ms, pair_cpu_ms = _timed(lambda: align_pair(i, j))
    T_i_j = None if result.T_i_j is None else np.asarray(result.T_i_j, np.float64)
    return Timed(T_i_j, pair_ms, pair_cpu_ms, whole_ms)


def align_peers(wire_i: Path, wire_j: Path, scale: float) -> dict[str, Timed]:
    """Aligns two views by every peer.

    Args:
        wire_i, wire_j: what the robots sent; peers get all points of it.
        scale: what lengths are multiplied with for the peers.
    """
    return {peer.name: _align(peer, wire_i, wire_j, scale) for peer in PEERS}


def _align(peer: Peer, wire_i: Path, wire_j: Path, scale: float) -> Timed:
    i, i_ms = _prepared(peer.prepare, wire_i, scale)
    j, j_ms = _prepared(peer.prepare, wire_j, scale)
    T_i_j, pair_ms, pair_cpu_ms = _timed(lambda: peer.align(i, j))
    T_i_j[:3, 3] /= scale
    answer = T_i_j if np.isfinite(T_i_j).all() else None
    return Timed(answer, pair_ms, pair_cpu_ms, i_ms + j_ms + pair_ms)


@lru_cache(maxsize=2 * CACHED_VIEWS)
def _prepared(prepare: Callable[[Floats], Any], wire: Path, scale: float) -> tuple[Any, float]:
    points = scale * _points(wire)
    view, view_ms, _ = _timed(lambda: prepare(points))
    return view, view_ms


def _points(wire: Path) -> Floats:
    from protocol import codec
    from protocol.clouds import points_of
    from protocol.messages import View

    return points_of(codec.unpack(View, wire.read_bytes())).xyz


def _timed(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """What a piece of work gives, its milliseconds, and those of all cores together."""
    began, cpu_began = time.perf_counter(), time.process_time()
    result = work()
    ended, cpu_ended = time.perf_counter(), time.process_time()
    return result, 1e3 * (ended - began), 1e3 * (cpu_ended - cpu_began)
