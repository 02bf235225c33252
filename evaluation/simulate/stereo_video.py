"""A stereo video of the synthetic world: robots of the ring, real lenses, a chessboard to measure
lengths by, both eyes side by side.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fleetpose.evaluation.simulate.world.render import Depth, Floats, Image, Quad, Renderer
from fleetpose.evaluation.simulate.world.ring import RingWorld, ring_rig
from fleetpose.evaluation.simulate.world.robots import GREY_SIGMA, HEIGHT, WIDTH
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.synthetic import mount

FPS = 10.0
FRAMES_PER_STATION = 6
BOARD = 9, 6  # inner corners
SQUARE_M = 0.12
_BOARD_M = 4.2  # in front of the robot
_SQUARE_PX = 40
_FINE = 2  # samples per pixel of what the lens bends
_WIDER = 1.45  # the field that a barrel distortion looks into


@dataclass(frozen=True)
class StereoVideo:
    """A video and its truth.

    Attributes:
        path: the file, both eyes side by side.
        rig: how it was taken.
        scene: what it shows.
        T_world_lefts: (S, 4, 4) where the left camera stood, for the same time each.
        radius_m: of the ring.
    """

    path: Path
    rig: StereoRig
    scene: Renderer
    T_world_lefts: Floats
    radius_m: float

    def true_depth(self, station: int, T_left_camera: Floats, K: Floats) -> Depth:
        """Exact depth (H, W) of a camera that stands so to the left one."""
        return self.scene.depth(self.T_world_lefts[station] @ T_left_camera, K, (WIDTH, HEIGHT))


def lens_rig(radius_m: float) -> StereoRig:
    """The ring's rig as cameras are: two lenses that differ and bend, the right one turned."""
    ideal = ring_rig(radius_m)
    R = np.asarray(cv2.Rodrigues(np.array((0.012, -0.02, 0.009)))[0])
    T_right_left = np.eye(4)
    T_right_left[:3, :3] = R
    T_right_left[:3, 3] = R @ ideal.T_right_left[:3, 3]
    return StereoRig(
        K_left=ideal.K_left,
        D_left=np.array((-0.16, 0.04, 6e-4, -5e-4, 0.0)),
        K_right=ideal.K_right * ((0.985, 1, 1.02), (1, 0.985, 0.98), (1, 1, 1)),
        D_right=np.array((-0.14, 0.03, -4e-4, 7e-4, 0.0)),
        T_right_left=T_right_left,
        size=ideal.size,
        T_robot_left=mount(),
    )


def make_video(path: Path, stations: int = 5, seed: int = 0) -> StereoVideo:
    """Renders and writes a lossless video of robots that stand around the rotunda, one after the
    other, each frame with noise of its own.

    Raises:
        FleetPoseError: OpenCV cannot write it.
    """
    world = RingWorld(stations, seed=seed)
    rig = lens_rig(world.radius_m)
    T_world_lefts = np.stack([world.T_world_robot(k) @ mount() for k in range(stations)])
    rng = np.random.default_rng((seed, 2))
    scene = world.scene.with_quads([board(T, rng) for T in T_world_lefts])
    code = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, FPS, (2 * WIDTH, HEIGHT))
    if not writer.isOpened():
        raise FleetPoseError(f"{path} cannot be written as FFV1")
    for T_world_left in T_world_lefts:
        clean = np.hstack(shot_through_lenses(scene, T_world_left, rig))
        for _ in range(FRAMES_PER_STATION):
            noise = GREY_SIGMA * rng.standard_normal(clean.shape, np.float32)
            writer.write(np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8))
    writer.release()
    return StereoVideo(path, rig, scene, T_world_lefts, world.radius_m)


def shot_through_lenses(
    scene: Renderer, T_world_left: Floats, rig: StereoRig
) -> tuple[Image, Image]:
    """What both cameras of a rig see (H, W, 3), without noise."""
    T_world_right = T_world_left @ np.linalg.inv(rig.T_right_left)
    return (
        _through_lens(scene, T_world_left, rig.K_left, rig.D_left),
        _through_lens(scene, T_world_right, rig.K_right, rig.D_right),
    )


def _through_lens(scene: Renderer, T_world_eye: Floats, K: Floats, D: Floats) -> Image:
    """A bent image: a straight one, larger and finer, looked up where each pixel's ray goes."""
    size = round(_FINE * _WIDER * WIDTH), round(_FINE * _WIDER * HEIGHT)
    focal = _FINE * K[0, 0]
    fine = np.array(((focal, 0, (size[0] - 1) / 2), (0, focal, (size[1] - 1) / 2), (0, 0, 1.0)))
    straight = scene.image(T_world_eye, fine, size, samples=1)
    straight = cv2.GaussianBlur(straight, (0, 0), 0.35 * _FINE)  # as wide as a pixel
    pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).reshape(-1, 1, 2)
    places = cv2.undistortPoints(pixels.astype(np.float64), K, D, P=fine)
    places = places.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return np.asarray(cv2.remap(straight, places, None, cv2.INTER_LINEAR), np.uint8)  # pyright: ignore[reportArgumentType, reportCallIssue]


def board(T_world_left: Floats, rng: np.random.Generator) -> Quad:
    """A chessboard in the sight of both eyes, leaning a little, with a white rim."""
    columns, rows = BOARD[0] + 3, BOARD[1] + 3
    fields = np.indices((rows, columns)).sum(0) % 2 == 0
    fields[[0, -1]] = fields[:, [0, -1]] = False
    grey = np.where(fields, 35, 215).astype(np.uint8).repeat(_SQUARE_PX, 0).repeat(_SQUARE_PX, 1)
    lean = np.asarray(cv2.Rodrigues(rng.uniform(-0.35, 0.35, 3) * (1, 1, 0.3))[0])
    right, down = SQUARE_M * columns * lean[:, 0], SQUARE_M * rows * lean[:, 1]
    middle = np.array((rng.uniform(0.0, 0.5), rng.uniform(-0.3, 0.3), _BOARD_M))
    R, centre = T_world_left[:3, :3], T_world_left[:3, 3]
    corner = middle - (right + down) / 2
    return Quad(R @ corner + centre, R @ right, R @ down, grey[..., None].repeat(3, 2))
