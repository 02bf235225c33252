"""A small scene with a chessboard, as a stereo rig sees it, with its true depth."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.simulate.stereo_video import SQUARE_M, board, shot_through_lenses
from fleetpose.evaluation.simulate.world.materials.textures import noise
from fleetpose.evaluation.simulate.world.render import Quad, Renderer
from fleetpose.evaluation.simulate.world.robots import rig_with
from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]

RIG = rig_with(0.5)
BOARD, SQUARE = (9, 6), SQUARE_M
_GREY_SIGMA = 1.5


@dataclass(frozen=True)
class Shot:
    """What a rig sees: both eyes (H, W, 3), and the true depth (H, W) of the left one, m."""

    left: Image
    right: Image
    depth: npt.NDArray[np.float32]

    @property
    def pair(self) -> ImagePair:
        """Both eyes."""
        return ImagePair(self.left, self.right, 0)


@lru_cache(maxsize=4)
def scene(seed: int) -> Renderer:
    """A far wall, three panels before it and a chessboard 4 m away."""
    rng = np.random.default_rng(seed)
    quads = [_wall(rng, np.array((-30.0, -20, 22)), np.array((60.0, 0, 5)), np.array((0, 40.0, 0)))]
    for x, y, z in ((-6.0, -2.5, 11.0), (1.5, -4.0, 14.0), (-4.0, 0.8, 7.5)):
        lean = rng.uniform(-0.8, 0.8)
        across, down = np.array((4.5, 0, lean)), np.array((0, 3.5, 0.4))
        quads.append(_wall(rng, np.array((x, y, z)), across, down))
    return Renderer([*quads, board(np.eye(4), rng)], np.zeros((4, 8, 3)))


@lru_cache(maxsize=32)
def _seen(seed: int, p2: float) -> Shot:
    D = np.array((0.0, 0.0, 0.0, p2, 0.0))
    rig = replace(RIG, D_right=D) if p2 else RIG
    rng = np.random.default_rng((seed, 1))
    left, right = (
        np.clip(np.rint(eye + rng.normal(0, _GREY_SIGMA, eye.shape)), 0, 255).astype(np.uint8)
        for eye in shot_through_lenses(scene(seed), np.eye(4), rig)
    )
    depth = scene(seed).depth(np.eye(4), RIG.K_left, RIG.size)
    return Shot(left, right, depth)


def seen(seed: int = 0, p2: float = 0.0) -> Shot:
    """What the rig sees of a scene; with a decentred right lens where `p2` is given."""
    return _seen(seed, p2)


FISHEYE_K = np.array([[300.0, 0, 319.5], [0, 300.0, 239.5], [0, 0, 1]])
FISHEYE_D = np.array([-0.03, 0.02, -0.015, 0.004])


def seen_through_fisheye(K: Floats = FISHEYE_K, D: Floats = FISHEYE_D, seed: int = 0) -> Shot:
    """What a rig of equidistant lenses sees of a scene; black beyond the pinhole's image of which
    it is made. Its depth is the pinhole's.
    """
    shot = seen(seed)
    pixels = np.stack(np.meshgrid(np.arange(640), np.arange(480)), -1).reshape(-1, 1, 2)
    places = cv2.fisheye.undistortPoints(pixels.astype(np.float64), K, D, P=RIG.K_left)
    places = places.reshape(480, 640, 2).astype(np.float32)
    eyes = (
        np.asarray(cv2.remap(eye, places, None, cv2.INTER_LINEAR), np.uint8)  # pyright: ignore[reportArgumentType, reportCallIssue]
        for eye in (shot.left, shot.right)
    )
    return Shot(*eyes, depth=shot.depth)


def median_off(depth_m: npt.NDArray[np.float32], true_m: npt.NDArray[np.float32]) -> float:
    """By which share depths are off, as a rule; inf where hardly any pixel has one."""
    both = np.isfinite(depth_m) & np.isfinite(true_m)
    if both.mean() < 0.1:
        return float("inf")
    return float(abs(np.median(depth_m[both] / true_m[both]) - 1))


def seen_with(depth_m: npt.NDArray[np.float32], K: Floats, size: tuple[int, int]) -> Floats:
    """The rig's true depth (H, W) as an equal camera with other intrinsics sees it."""
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1]), [1.0]), -1)
    places = pixels.reshape(-1, 3) @ (RIG.K_left @ np.linalg.inv(K)).T
    places = places[:, :2].reshape(size[1], size[0], 2).astype(np.float32)
    found = cv2.remap(  # pyright: ignore[reportCallIssue] (its stubs know two maps only)
        depth_m,
        places,
        None,  # pyright: ignore[reportArgumentType]
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,  # pyright: ignore[reportArgumentType, reportCallIssue]
    )
    return np.asarray(found, np.float64)


def save(path: Path, image: npt.NDArray[np.generic]) -> None:
    """An image under its name; the folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".pgm" and image.ndim == 3:
        image = image[..., 1]  # its format knows no colours
    cv2.imwrite(str(path), np.asarray(image))  # pyright: ignore[reportArgumentType, reportCallIssue]


def half(image: Image) -> Image:
    """An image at half its size."""
    return np.asarray(
        cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8
    )


def content(rig: StereoRig = RIG, **more: object) -> dict:
    """The rig under OpenCV's names, without what is not asked for."""
    return {
        "K1": rig.K_left.tolist(),
        "D1": rig.D_left.tolist(),
        "K2": rig.K_right.tolist(),
        "D2": rig.D_right.tolist(),
        "R": rig.T_right_left[:3, :3].tolist(),
        "T": rig.T_right_left[:3, 3].tolist(),
        **more,
    }


def _wall(rng: np.random.Generator, corner: Floats, across: Floats, down: Floats) -> Quad:
    grey = np.clip(128 + 45 * noise(rng, 700, 900, 40, 5, 0.8), 0, 255).astype(np.uint8)
    return Quad(corner, across, down, grey[..., None].repeat(3, 2))
