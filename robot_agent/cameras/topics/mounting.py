"""Where a camera sits on its robot, by tf."""

import logging
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
from fleetpose.rosmsg.transforms import Tf

log = logging.getLogger(__name__)

Floats = npt.NDArray[np.float64]


class Mounting(NamedTuple):
    """Attributes:
    base: the frame of the robot's body as tf calls it; empty where tf does not know it.
    chain: the frames from the base to the camera.
    moves: whether a joint between them may move.
    why_not: why the camera is taken to stand at the robot's origin; empty where tf tells.
    """

    base: str
    chain: tuple[str, ...]
    moves: bool
    why_not: str = ""


def mounting(tf: Tf, base: str, frame: str, whose: str) -> Mounting:
    """How a camera's frame hangs on the robot's body.

    Args:
        tf: which frame hangs where.
        base: the frame of the robot's body.
        frame: of the camera.
        whose: tf it is, in words.
    """
    if not tf.parents:
        return Mounting("", (), False, f"{whose} has no tf")
    found = tf.find(base, near=frame)
    if found is None:
        known = ", ".join(sorted({*tf.parents, *tf.parents.values()})[:8])
        return Mounting("", (), False, f"tf has no frame '{base}': give --base ({known})")
    chain = tf.chain(found, frame)
    if chain is None:
        return Mounting("", (), False, f"tf joins '{found}' and '{frame}' by nothing")
    return Mounting(found, tuple(chain), tf.moves(found, frame))


def camera_on_robot(tf: Tf, where: Mounting, frame: str, at_ns: int | None = None) -> Floats:
    """T_robot_camera (4, 4); of a camera that looks ahead at the robot's origin where tf does not
    tell.
    """
    T = tf.lookup(where.base, frame, at_ns) if where.base else None
    return ROBOT_FROM_CAMERA.copy() if T is None else T


def axes_rectified(T_robot_camera: Floats, R: Floats) -> Floats:
    """T_robot_rectified (4, 4): tf tells of the camera's own axes, images have rectified ones.

    Args:
        T_robot_camera: (4, 4).
        R: (3, 3) of its CameraInfo, own axes to rectified ones.
    """
    T = T_robot_camera.copy()
    T[:3, :3] = T[:3, :3] @ R.T
    return T
