"""The tree of tf: which frame hangs where."""

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg.stamps import stamp_ns

Floats = npt.NDArray[np.float64]

KEPT = 200  # moments of a joint: two seconds at 100 Hz
_FURTHEST_M = 2e7  # coordinates of a grid that spans the earth
_DEEPEST = 100  # frames between two; more are a circle


def pose_matrix(position: Any, orientation: Any) -> Floats:
    """(4, 4) of a position and a quaternion (x, y, z, w).

    Raises:
        CodecError: they are no pose.
    """
    q = np.array([orientation.x, orientation.y, orientation.z, orientation.w], np.float64)
    t = np.array([position.x, position.y, position.z], np.float64)
    norm = float(np.linalg.norm(q))
    here = bool((np.abs(t) <= _FURTHEST_M).all())  # not where it is nan
    if not here or not np.isfinite(norm) or norm < 1e-6:
        raise CodecError(f"a pose with the quaternion {q.tolist()} at {t.tolist()}")
    x, y, z, w = q / norm
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = t
    return T


def inverse(T: Floats) -> Floats:
    """Of a pose (4, 4)."""
    back = np.eye(4)
    back[:3, :3] = T[:3, :3].T
    back[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return back


@dataclass
class Tf:
    """Frames and how they hang on each other.

    Attributes:
        parents: of each frame.
    """

    parents: dict[str, str] = field(default_factory=dict)
    _static: dict[str, Floats] = field(default_factory=dict)
    _moving: dict[str, deque[tuple[int, Floats]]] = field(default_factory=dict)

    def add(self, message: Any, static: bool) -> None:
        """Takes a `TFMessage`; a transform that is none is left out."""
        for one in message.transforms:
            child = str(one.child_frame_id).lstrip("/")
            try:
                T = pose_matrix(one.transform.translation, one.transform.rotation)
            except CodecError:
                continue
            self.parents[child] = str(one.header.frame_id).lstrip("/")
            if static:
                self._static[child] = T
            else:
                self._moving.setdefault(child, deque(maxlen=KEPT)).append((stamp_ns(one), T))

    def chain(self, target: str, source: str) -> list[str] | None:
        """The frames from one to the other by way of their nearest common one, None where none
        joins them.
        """
        up, down = self._ancestors(target), self._ancestors(source)
        common = next((frame for frame in down if frame in up), None)
        if common is None:
            return None
        return [*up[: up.index(common)], common, *down[: down.index(common)][::-1]]

    def lookup(self, target: str, source: str, at_ns: int | None = None) -> Floats | None:
        """T_target_source (4, 4), None where nothing joins them.

        Args:
            at_ns: of joints that move, the moment nearest to it counts; None: the newest.
        """
        frames = self.chain(target, source)
        if frames is None:
            return None
        T = np.eye(4)
        for a, b in pairwise(frames):
            if self.parents.get(b) == a:
                T = T @ self._edge(b, at_ns)
            else:
                T = T @ inverse(self._edge(a, at_ns))
        return T

    def top(self, frame: str) -> str:
        """The uppermost frame above one; itself where there is none."""
        return self._ancestors(frame)[-1]

    def moves(self, target: str, source: str) -> bool:
        """Whether a joint between the two is not known to stand still."""
        frames = self.chain(target, source) or []
        joints = [b if self.parents.get(b) == a else a for a, b in pairwise(frames)]
        return any(joint not in self._static for joint in joints)

    def find(self, name: str, near: str = "") -> str | None:
        """The frame of a name, or of that name behind a robot's prefix: that of another frame, or
        the only one there is.
        """
        known = {*self.parents, *self.parents.values()}
        if name in known:
            return name
        prefixed = f"{near.partition('/')[0]}/{name}"
        if prefixed in known:
            return prefixed
        behind = [frame for frame in known if frame.endswith((f"/{name}", f"_{name}"))]
        return behind[0] if len(behind) == 1 else None

    def _ancestors(self, frame: str) -> list[str]:
        frames = [frame.lstrip("/")]
        while frames[-1] in self.parents and len(frames) < _DEEPEST:
            frames.append(self.parents[frames[-1]])
        return frames

    def _edge(self, child: str, at_ns: int | None) -> Floats:
        if child in self._static:
            return self._static[child]
        moments = self._moving[child]
        if at_ns is None:
            return moments[-1][1]
        return min(moments, key=lambda moment: abs(moment[0] - at_ns))[1]
