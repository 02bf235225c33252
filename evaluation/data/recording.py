"""Recordings with ground truth. Truth stays in the evaluation.

Camera frames have OpenCV axes; `T_world_camera` maps camera points to the world, metres.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import get_args

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.options.names import CloudKind

CLOUD_KINDS: tuple[CloudKind, ...] = get_args(CloudKind)


@dataclass(frozen=True)
class TrueView:
    """One view with its truth.

    Attributes:
        index: place in the list of all views of the recording sorted by name.
        name: of the image file (posed views) or of the frame (RGB-D), e.g. `frame-000010`.
        image: the colour image, registered to the depth where there is one; of a scan, which has
            none, the scan.
        cloud: the npz cloud or the depth image; none if this view has no cloud of the chosen kind.
        width, height, K: pinhole camera, px.
        T_world_camera: (4, 4), rotation projected to SO(3).
        partner: name of the view that was its second eye, for stereo clouds.
        baseline_m: distance to that partner.
        ring_angle_deg: place on the ring, where the recording is one.
    """

    index: int
    name: str
    image: Path
    cloud: Path | None
    width: int
    height: int
    K: Floats
    T_world_camera: Floats
    partner: str | None = None
    baseline_m: float | None = None
    ring_angle_deg: float | None = None

    def T_to(self, other: "TrueView") -> Floats:
        """(4, 4) the other camera in this one."""
        return inverse(self.T_world_camera) @ other.T_world_camera

    @property
    def is_scan(self) -> bool:
        """Whether it is a cloud without an image."""
        return self.image == self.cloud


@dataclass(frozen=True)
class Recording:
    """A folder of views with truth; `clouds` is none for RGB-D folders."""

    directory: Path
    clouds: CloudKind | None
    views: tuple[TrueView, ...]

    @property
    def is_rgbd(self) -> bool:
        return self.clouds is None

    @property
    def usable(self) -> tuple[TrueView, ...]:
        """The views that have a cloud."""
        return tuple(view for view in self.views if view.cloud is not None)

    def view(self, index: int) -> TrueView:
        """A view by its index, which is not its place where frames without truth are left out."""
        return next(view for view in self.views if view.index == index)

    def tracks(self, view: TrueView) -> tuple[npt.NDArray[np.int64], Floats] | None:
        """Track ids (N,) and pixels (N, 2) of a view's points in `sparse/`, whatever the clouds."""
        return None if self.is_rgbd else _tracks(self.directory / "sparse" / npz_name(view.name))


@lru_cache(maxsize=2048)
def _tracks(path: Path) -> tuple[npt.NDArray[np.int64], Floats] | None:
    if not path.exists():
        return None
    with np.load(path) as arrays:
        return arrays["track_id"], arrays["uv"].astype(np.float64)


def are_partners(a: TrueView, b: TrueView) -> bool:
    """Whether one view was the other's second eye: their stereo clouds hold identical points."""
    return a.partner == b.name or b.partner == a.name


def shared_tracks(recording: Recording, a: TrueView, b: TrueView) -> int | None:
    """How many track ids two views have in common in `sparse/`; none where there are no tracks."""
    tracks_a, tracks_b = recording.tracks(a), recording.tracks(b)
    if tracks_a is None or tracks_b is None:
        return None
    return len(np.intersect1d(tracks_a[0], tracks_b[0]))


def in_ring_order(views: tuple[TrueView, ...]) -> tuple[TrueView, ...]:
    """Views by their angle on the ring; in the order of their names where there is none."""
    if any(view.ring_angle_deg is None for view in views):
        return views
    return tuple(sorted(views, key=lambda view: (view.ring_angle_deg, view.name)))


def npz_name(name: str) -> str:
    """Of the cloud of an image."""
    return Path(name).with_suffix(".npz").name
