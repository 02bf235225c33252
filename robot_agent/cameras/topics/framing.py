"""Messages of one moment become a frame: colour and depth, two eyes, colour and a cloud."""

from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.protocol.messages import Camera as CameraModel
from fleetpose.protocol.messages import NoiseModel
from fleetpose.robot_agent.cameras.base import DepthImage, Frame, Ranges, ScatteredPoints
from fleetpose.robot_agent.cameras.folders.cloud import SCANNER_NOISE
from fleetpose.robot_agent.cameras.folders.files import model_of
from fleetpose.robot_agent.cameras.rgbd.recording import FURTHEST_M, KINECT_NOISE
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.topics.mounting import axes_rectified
from fleetpose.rosmsg.camera_infos import CameraInfo, rectifying_maps
from fleetpose.rosmsg.clouds import xyz_of
from fleetpose.rosmsg.depths import depth_m
from fleetpose.rosmsg.images import bgr, grey_or_bgr

Floats = npt.NDArray[np.float64]
Depth = npt.NDArray[np.float32]

_NEAREST_M = 0.05  # what is nearer is the sensor itself


class Framing(Protocol):
    """Makes frames of two messages."""

    def frame(self, image: Any, ranges: Any, stamp_ns: int, T_robot_camera: Floats) -> Frame:
        """A frame.

        Args:
            image: message of colours, or of the left eye.
            ranges: message of depths, of the right eye, or a cloud.
            stamp_ns: its moment.
            T_robot_camera: (4, 4) of the camera's own axes.

        Raises:
            CodecError: a message is damaged.
            CalibrationError: it does not fit its info.
        """
        ...


class Lens:
    """Rectifies images of one camera.

    Args:
        topic: for errors.
        info: of the camera.
        rectified: whether its images are so already.
    """

    def __init__(self, topic: str, info: CameraInfo, rectified: bool) -> None:
        self.info, self._topic = info, topic
        self._maps = None if rectified else rectifying_maps(info)

    @property
    def K(self) -> Floats:
        """(3, 3) of what `image` and `depth` give, px."""
        return self.info.K_rectified

    def image(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """A rectified image."""
        self.check(image.shape)
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), np.uint8)

    def depth(self, depth: Depth) -> Depth:
        """A rectified depth image: nothing is made up between two depths."""
        self.check(depth.shape)
        if self._maps is None:
            return depth
        none = float("nan")
        remapped = cv2.remap(
            depth, *self._maps, cv2.INTER_NEAREST, None, cv2.BORDER_CONSTANT, (none,)
        )
        return np.asarray(remapped, np.float32)

    def check(self, shape: tuple[int, ...]) -> None:
        """Raises:
        CalibrationError: an image is not of the info's size.
        """
        if (shape[1], shape[0]) != self.info.size:
            raise CalibrationError(
                f"{self._topic} has images of {shape[1]}x{shape[0]}, its camera_info is of "
                f"{self.info.size[0]}x{self.info.size[1]}: give --calibration FILE"
            )

    def model(self, T_robot_camera: Floats, noise: NoiseModel, kind: str) -> CameraModel:
        """What the fleet is told of the camera."""
        return model_of(
            f"the camera_info of {self._topic}",
            width=self.info.size[0],
            height=self.info.size[1],
            K=self.K,
            T_robot_camera=axes_rectified(T_robot_camera, self.info.R),
            noise=noise,
            kind=kind,
        )


class RgbdFraming:
    """Colour and depth; depth of other axes than those of the image is projected into it.

    Args:
        colour: of the image.
        depth: of the depth images; None: they lie on the image's pixels.
        T_colour_depth: (4, 4) of both cameras' own axes.
        furthest_m: beyond, depth is noise.
    """

    def __init__(
        self,
        colour: Lens,
        depth: Lens | None = None,
        T_colour_depth: Floats | None = None,
        furthest_m: float = FURTHEST_M,
    ) -> None:
        self._colour, self._depth = colour, depth
        self._T_colour_depth = np.eye(4) if T_colour_depth is None else T_colour_depth
        self._furthest_m = furthest_m

    def frame(self, image: Any, ranges: Any, stamp_ns: int, T_robot_camera: Floats) -> Frame:
        """See `Framing`."""
        depth = depth_m(ranges)
        depth[depth > self._furthest_m] = np.nan
        if self._depth is None:
            depth = self._colour.depth(depth)
        else:
            depth = self._projected(self._depth, self._depth.depth(depth))
        model = self._colour.model(T_robot_camera, KINECT_NOISE, "rgbd")
        return Frame(stamp_ns, self._colour.image(bgr(image)), DepthImage(depth), model)

    def _projected(self, lens: Lens, depth: Depth) -> Depth:
        """Depths of another camera on the pixels of the image; of several the nearest."""
        v, u = np.nonzero(np.isfinite(depth))
        z = depth[v, u].astype(np.float64)
        K = lens.K
        points = np.stack(((u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z), axis=1)
        R, t = self._T_colour_depth[:3, :3], self._T_colour_depth[:3, 3]
        own = points @ lens.info.R @ R.T + t  # rectified axes of the depth camera to its own ones
        uv, z = projected(own @ self._colour.info.R.T, self._colour.K, self._colour.info.size)
        width, height = self._colour.info.size
        grid = np.full((height, width), np.inf, np.float32)
        columns, rows = np.rint(uv).astype(np.intp).T
        np.minimum.at(grid, (rows, columns), z.astype(np.float32))
        grid[~np.isfinite(grid)] = np.nan
        return grid


class StereoFraming:
    """Two eyes."""

    def __init__(self, matcher: StereoMatcher) -> None:
        self._matcher = matcher

    def frame(self, image: Any, ranges: Any, stamp_ns: int, T_robot_camera: Floats) -> Frame:
        """See `Framing`; where the rig sits, its matcher knows."""
        del T_robot_camera
        return self._matcher.frame(grey_or_bgr(image), grey_or_bgr(ranges), stamp_ns)


class CloudFraming:
    """Colour and a cloud: a depth image where the cloud lies on the image's pixels.

    Args:
        colour: of the image.
        T_colour_cloud: (4, 4) of the camera's own axes and the cloud's; None: they are the same.
    """

    def __init__(self, colour: Lens, T_colour_cloud: Floats | None = None) -> None:
        self._colour, self._T_colour_cloud = colour, T_colour_cloud

    def frame(self, image: Any, ranges: Any, stamp_ns: int, T_robot_camera: Floats) -> Frame:
        """See `Framing`."""
        xyz = xyz_of(ranges)
        picture = bgr(image)
        seen: Ranges
        if self._T_colour_cloud is None and xyz.shape[:2] == picture.shape[:2]:
            depth = xyz[..., 2].astype(np.float32)
            depth[~((depth > 0) & (depth <= FURTHEST_M))] = np.nan
            seen, noise = DepthImage(self._colour.depth(depth)), KINECT_NOISE
        else:
            seen, noise = self._scattered(xyz.reshape(-1, 3)), SCANNER_NOISE
        model = self._colour.model(T_robot_camera, noise, "cloud")
        return Frame(stamp_ns, self._colour.image(picture), seen, model)

    def _scattered(self, points: Floats) -> ScatteredPoints:
        points = points[np.isfinite(points).all(axis=1)]
        if (T := self._T_colour_cloud) is not None:
            points = points @ T[:3, :3].T + T[:3, 3]
        colour = self._colour
        return ScatteredPoints(*projected(points @ colour.info.R.T, colour.K, colour.info.size))


def projected(points: Floats, K: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and depths (N,), m, of the points (M, 3) that fall into an image."""
    points = points[points[:, 2] > _NEAREST_M]
    uv = points[:, :2] / points[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
    inside = ((uv > -0.5) & (uv < np.array(size) - 0.5)).all(axis=1)
    return uv[inside], points[inside, 2]
