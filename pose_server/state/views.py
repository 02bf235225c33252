"""The views that the server keeps, encoded: 60 s of each robot, at least twenty, and all that
something holds on to.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features.matching import ratio_matches
from fleetpose.pose_server.geometry.features.motion import some_together
from fleetpose.pose_server.workers.jobs import EncodedView
from fleetpose.protocol.clouds import decode_salient, points_of, some_points_of
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import Camera, View, ViewName

KEEP_S = 60.0
KEEP_AT_LEAST = 20
MIN_POINTS = 10
_DEPTH_SAMPLE = 2000  # points for the median depth
_SIGNATURE_POINTS = 300
_LIKE_RATIO = 0.8
_CHANCE, _ALIKE = 0.045, 0.13  # shares of the points that match by chance, and in like views
_STILL_MATCHES = 40
_TOGETHER, _REACH_SHARE = 3, 0.15  # points that move as one, share of the image's width
_NEAR_PX, _SAME_COSINE = 3.0, 0.9
STILL_PX = 0.15


class NoDepthError(CodecError):
    """A view that has too few points with depth to be of use."""


@dataclass(frozen=True)
class KeptView:
    """A view as it came, and what the server needs to know of it without decoding it again.

    Attributes:
        payload: the encoded `View`.
        received_s: the server's monotonic clock.
        signature_uv: (S, 2) pixels of the signature's points.
        signature: (S, D) uint8 descriptors of the strongest salient points, to guess which
            views are alike.
        content: tells whether two views have the same points: their robot saw no change.
        frozen_s: for how long the robot's camera has given the same image, to the last bit.
        on_way_s: that the robot's view before it took to arrive.
        share: of its salient points that the robot sent.
        depth_points: how many salient points have depth, had all come; or points of a glance at the
            cloud, if those are more.
        glance_points: how many points a glance at the cloud, at even steps over it, found.
    """

    name: ViewName
    payload: bytes
    stamp_ns: int
    received_s: float
    camera: Camera
    median_depth_m: float
    has_image: bool
    up_camera: npt.NDArray[np.float64] | None
    up_sigma_rad: float | None
    signature: npt.NDArray[np.uint8]
    signature_uv: npt.NDArray[np.float32]
    content: int
    frozen_s: float = 0.0
    on_way_s: float = 0.0
    share: float = 1.0
    depth_points: int = 0
    glance_points: int = 0

    @property
    def encoded(self) -> EncodedView:
        """For a worker."""
        return EncodedView(self.name, self.payload)


def open_view(
    payload: bytes,
    encoding: str | None,
    now_s: float,
    newest_of: Callable[[str], KeptView | None] = lambda robot: None,
) -> KeptView:
    """Decodes a view in full, so that nothing damaged is ever kept.

    Args:
        payload, encoding: as it came.
        now_s: when, by the server's monotonic clock.
        newest_of: the newest view of a robot, to be read once where nothing changed since.

    Raises:
        CodecError: it is no valid view, has no points, or some outside of its image.
    """
    view = unpack(View, payload, encoding)
    content = hash((view.cloud, view.salient))
    before = newest_of(view.name.robot)
    if before is not None and before.content == content and same_camera(before.camera, view.camera):
        return replace(
            before,
            name=view.name,
            payload=payload,
            stamp_ns=view.stamp_ns,
            received_s=now_s,
            has_image=view.has_image,
            up_camera=view.up_camera,
            up_sigma_rad=view.up_sigma_rad,
            frozen_s=view.frozen_s,
            on_way_s=view.on_way_s,
            share=view.share,
        )
    points = some_points_of(view, _DEPTH_SAMPLE)
    glance = len(points.xyz)
    if glance < MIN_POINTS:
        points = points_of(view)
    if len(points.xyz) < MIN_POINTS:
        raise NoDepthError(
            f"view {view.name} has {len(points.xyz)} points with depth, need {MIN_POINTS}"
        )
    salient = decode_salient(view.salient)
    _check_inside("point", points.uv, view.camera)
    _check_inside("salient point", salient.uv, view.camera)
    with_depth = np.flatnonzero(np.isfinite(salient.inverse_depth))
    strongest = with_depth[:_SIGNATURE_POINTS]
    return KeptView(
        name=view.name,
        payload=payload,
        stamp_ns=view.stamp_ns,
        received_s=now_s,
        camera=view.camera,
        median_depth_m=float(np.median(points.xyz[:, 2])),
        has_image=view.has_image,
        up_camera=view.up_camera,
        up_sigma_rad=view.up_sigma_rad,
        signature=salient.descriptors[strongest],
        signature_uv=salient.uv[strongest],
        content=content,
        frozen_s=view.frozen_s,
        on_way_s=view.on_way_s,
        share=view.share,
        depth_points=max(round(len(with_depth) / max(view.share, 1e-3)), len(points.xyz)),
        glance_points=glance,
    )


def likeness(a: KeptView, b: KeptView) -> float:
    """A cheap guess, 0 to 1, of how much two views show the same: clear matches of the strongest
    points, beyond those that views of different things have by chance.
    """
    share = len(_clear_matches(a, b, _LIKE_RATIO)) / max(min(len(a.signature), len(b.signature)), 1)
    return float(np.clip((share - _CHANCE) / (_ALIKE - _CHANCE), 0.0, 1.0))


def likely_matches(a: KeptView, b: KeptView) -> npt.NDArray[np.float32]:
    """(M, 4) pixels of both views that look alike, u_a v_a u_b v_b, without a thought of geometry;
    the strongest points first.
    """
    matches = _clear_matches(a, b, _LIKE_RATIO)
    return np.column_stack((a.signature_uv[matches[:, 0]], b.signature_uv[matches[:, 1]]))


def same_camera(a: Camera, b: Camera) -> bool:
    """Whether two views were taken with one calibration."""
    return (
        (a.width, a.height, a.noise) == (b.width, b.height, b.noise)
        and np.array_equal(a.K, b.K)
        and np.array_equal(a.T_robot_camera, b.T_robot_camera)
    )


def _check_inside(what: str, uv: npt.NDArray[np.floating], camera: Camera) -> None:
    outside = (uv < -1) | (uv > (camera.width, camera.height))
    if outside.any():
        u, v = uv[outside.any(axis=1)][0]
        raise CodecError(
            f"a {what} outside of the image: ({u:g}, {v:g}) in {camera.width}x{camera.height}"
        )


def stands_still(a: KeptView, b: KeptView) -> bool:
    """Whether a robot did not move between two of its views: its strongest points kept their
    pixels.
    """
    if not same_camera(a.camera, b.camera) or a.signature.shape[1] != b.signature.shape[1]:
        return False
    if a.content == b.content:
        return True
    shift = _kept_places(a, b)
    if len(shift) < _STILL_MATCHES:
        return False
    drift = np.abs(np.median(shift, axis=0)).max()
    return bool(drift < STILL_PX and np.median(np.linalg.norm(shift, axis=1)) < 3 * STILL_PX)


def something_moved(a: KeptView, b: KeptView) -> bool:
    """Whether some of the strongest points may have gone elsewhere together, in two views of a
    robot that did not move: a worker is to look closer.
    """
    if a.content == b.content:
        return False
    matches = _clear_matches(a, b, _LIKE_RATIO)
    shift = b.signature_uv[matches[:, 1]] - a.signature_uv[matches[:, 0]]
    off = np.linalg.norm(shift, axis=1) > _NEAR_PX
    uv = a.signature_uv[matches[off, 0]]
    return some_together(uv, shift[off], _REACH_SHARE * a.camera.width, _TOGETHER)


def _kept_places(a: KeptView, b: KeptView) -> npt.NDArray[np.float32]:
    """(M, 2) shifts in pixels of points that look the same in both and lie near each other."""
    near = [np.abs(np.subtract.outer(a.signature_uv[:, c], b.signature_uv[:, c])) for c in (0, 1)]
    k, m = np.nonzero((near[0] < _NEAR_PX) & (near[1] < _NEAR_PX))
    looks_a, looks_b = _unit(a.signature[k]), _unit(b.signature[m])
    same = (looks_a * looks_b).sum(axis=1) > _SAME_COSINE
    return b.signature_uv[m[same]] - a.signature_uv[k[same]]


def _clear_matches(a: KeptView, b: KeptView, ratio: float) -> npt.NDArray[np.int64]:
    matches, _ = ratio_matches(_unit(a.signature), _unit(b.signature), ratio)
    return matches


def _unit(descriptors: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    vectors = descriptors.astype(np.float32)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)


class ViewStore:
    """Kept views by name."""

    def __init__(self) -> None:
        self._views: dict[ViewName, KeptView] = {}
        self._by_robot: dict[str, list[ViewName]] = {}

    def __contains__(self, name: ViewName) -> bool:
        return name in self._views

    def __getitem__(self, name: ViewName) -> KeptView:
        return self._views[name]

    def get(self, name: ViewName) -> KeptView | None:
        """The view, or None if it is not kept."""
        return self._views.get(name)

    def count(self, robot: str) -> int:
        """How many views of a robot are kept."""
        return len(self._by_robot.get(robot, ()))

    def keep(self, view: KeptView) -> None:
        """Adds a view."""
        if view.name not in self._views:
            self._by_robot.setdefault(view.name.robot, []).append(view.name)
        self._views[view.name] = view

    def prune(self, now_s: float, held: Iterable[ViewName]) -> set[ViewName]:
        """Drops what is old and not held; returns what was dropped."""
        held = set(held)
        dropped: set[ViewName] = set()
        for robot, names in self._by_robot.items():
            free = [name for name in names[:-KEEP_AT_LEAST] if name not in held]
            old = {name for name in free if now_s - self._views[name].received_s > KEEP_S}
            if old:
                self._by_robot[robot] = [name for name in names if name not in old]
                dropped |= old
        for name in dropped:
            del self._views[name]
        return dropped
