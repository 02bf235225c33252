"""The fleet as a reconstruction: COLMAP, Bundler and NVM, of the views that the server has the
points of.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.formats.arrays import FormatError
from fleetpose.formats.reconstructions.bundler import write_bundler
from fleetpose.formats.reconstructions.colmap import write_colmap
from fleetpose.formats.reconstructions.nvm import write_nvm
from fleetpose.formats.reconstructions.photos import Model, Photo
from fleetpose.pose_server.geometry.features.matching import ratio_matches
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.persistence.placed import Placed
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.clouds import decode_salient
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.messages import View, ViewName

Floats = npt.NDArray[np.floating]
_RATIO = 0.8  # of descriptors' distances (Lowe 2004)
_SIGMAS = 3.0
_GREY = 128.0  # images are not decoded here
_IMAGES = "images"


class _Seen:
    """The keypoints of a view that have depth.

    Attributes:
        uv: (N, 2) px.
        p: (N, 3) in the fleet frame.
        sigma_m: (N,) of their depths.
        looks: (N, D) descriptors, of unit length.
    """

    def __init__(self, placed: Placed, view: View) -> None:
        salient = decode_salient(view.salient)
        known = np.isfinite(salient.inverse_depth) & (salient.inverse_depth > 0)
        z = 1.0 / salient.inverse_depth[known].astype(np.float64)
        self.placed, self.camera = placed, view.camera
        self.uv = salient.uv[known].astype(np.float64)
        self.sigma_m = salient.inverse_depth_sigma[known].astype(np.float64) * z**2
        rays = np.column_stack((self.uv, np.ones(len(z)))) @ np.linalg.inv(view.camera.K).T
        self.p = transform(placed.T_fleet_camera, rays * z[:, None])
        looks = salient.descriptors[known].astype(np.float32)
        self.looks = looks / np.maximum(np.linalg.norm(looks, axis=1, keepdims=True), 1e-6)

    def matches(self, other: "_Seen") -> npt.NDArray[np.int64]:
        """(M, 2) keypoints of both that look alike and lie at one place."""
        if self.looks.shape[1] != other.looks.shape[1] or not min(len(self.p), len(other.p)):
            return np.zeros((0, 2), np.int64)
        pairs, _ = ratio_matches(self.looks, other.looks, _RATIO)
        a, b = pairs[:, 0], pairs[:, 1]
        apart = np.linalg.norm(self.p[a] - other.p[b], axis=1)
        allowed = _SIGMAS * np.hypot(self.sigma_m[a], other.sigma_m[b])
        return np.asarray(pairs[apart < allowed], np.int64)


def reconstruction_of(site: Site, placed: Mapping[ViewName, Placed]) -> Model:
    """The views of the fleet's own component as photos, and their keypoints as points: what was
    matched along a link is one.

    Raises:
        CodecError: a stored view is damaged.
    """
    own = "" if site.gauge is None else site.component_name(site.gauge)
    kept = [one for one in placed.values() if one.component == own and one.view in site.views]
    seen = [_Seen(one, unpack(View, site.views[one.view].payload)) for one in kept]
    point_of, count = _tracks(site, seen)
    total, weights = np.zeros((count, 3)), np.zeros(count)
    for one, numbers in zip(seen, point_of, strict=True):
        weight = 1.0 / np.maximum(one.sigma_m, 1e-6) ** 2
        np.add.at(total, numbers, one.p * weight[:, None])
        np.add.at(weights, numbers, weight)
    points = total / weights[:, None]
    photos = [_photo(one, numbers) for one, numbers in zip(seen, point_of, strict=True)]
    return Model(tuple(photos), points, np.full((count, 3), _GREY))


def image_name(view: ViewName) -> str:
    """What files call the image of a view."""
    return f"{_IMAGES}/{view.robot}_{view.epoch}_{view.seq}.jpg"


def write_reconstruction(
    kind: str, folder: Path, model: Model, images: Mapping[ViewName, bytes]
) -> None:
    """Writes `sparse/0`, `bundle.out` or `fleet.nvm`, and the images that there are.

    Raises:
        FormatError: a camera has no place in the format.
        OSError: it cannot be written.
    """
    (folder / _IMAGES).mkdir(parents=True, exist_ok=True)
    for view, jpeg in images.items():
        (folder / image_name(view)).write_bytes(jpeg)
    if kind == "colmap":
        model_folder = folder / "sparse" / "0"
        model_folder.mkdir(parents=True, exist_ok=True)
        write_colmap(model_folder, _bare(model), binary=True)
    elif kind == "bundler":
        write_bundler(folder / "bundle.out", model)
    elif kind == "nvm":
        write_nvm(folder / "fleet.nvm", model)
    else:
        raise FormatError(f"'{kind}' is no format of reconstructions")


def _bare(model: Model) -> Model:
    """With names below the folder of images, as COLMAP has them."""
    named = [replace(photo, name=photo.name.removeprefix(f"{_IMAGES}/")) for photo in model.photos]
    return Model(tuple(named), model.points, model.colours)


def _photo(seen: _Seen, numbers: npt.NDArray[np.int64]) -> Photo:
    camera = seen.camera
    centre = np.asarray(camera.K[:2, 2], np.float64)
    return Photo(
        name=image_name(seen.placed.view),
        focal_px=np.asarray(camera.K[[0, 1], [0, 1]], np.float64),
        distortion=np.zeros(4),
        T_camera_world=inverse(seen.placed.T_fleet_camera),
        seen=numbers,
        at=seen.uv - centre,
        centre=centre,
        size=(camera.width, camera.height),
    )


def _tracks(site: Site, seen: Sequence[_Seen]) -> tuple[list[npt.NDArray[np.int64]], int]:
    """Of each view's keypoints the number of the point that they are, and how many points there
    are. A match that would give a point two keypoints of one view is left out.
    """
    number = {one.placed.view: k for k, one in enumerate(seen)}
    starts = np.cumsum([0, *(len(one.uv) for one in seen)])
    point = list(range(int(starts[-1])))  # the track of each keypoint, by its first one
    views = {k: {v} for v in range(len(seen)) for k in range(starts[v], starts[v + 1])}
    members = {k: [k] for k in point}
    for a, b in _linked(site, number):
        for m, n in seen[a].matches(seen[b]).tolist():
            s, t = sorted((point[starts[a] + m], point[starts[b] + n]))
            if s != t and not views[s] & views[t]:
                for k in members[t]:
                    point[k] = s
                members[s] += members.pop(t)
                views[s] |= views.pop(t)
    _, numbers = np.unique(np.array(point, np.int64), return_inverse=True)
    return list(np.split(numbers.astype(np.int64), starts[1:-1])), len(members)


def _linked(site: Site, number: Mapping[ViewName, int]) -> Iterable[tuple[int, int]]:
    """Pairs of views that a link joins which the solution rests on, or of which one hangs on the
    other.
    """
    assert site.solution is not None
    for edge in site.edges.values():
        if site.solution.edges[edge.key].weight > 0 and edge.a in number and edge.b in number:
            yield number[edge.a], number[edge.b]
    for view, k in number.items():
        here = site.attached(view)
        if here is not None and here.keyframe != view and here.keyframe in number:
            yield number[here.keyframe], k
