"""One rig whose numbers are known, of which files in every tool's layout are made."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SIZE = (752, 480)
SIDES = ("left", "right")
K: dict[str, Floats] = {
    "left": np.array([[459.0, 0, 367], [0, 457, 248], [0, 0, 1]]),
    "right": np.array([[457.0, 0, 380], [0, 456, 255], [0, 0, 1]]),
}
D: dict[str, Floats] = {
    "left": np.array([-0.283, 0.074, 0.0002, 0.00002, 0.01]),
    "right": np.array([-0.284, 0.0745, -0.0001, -0.00004, 0.02]),
}
FISHEYE: dict[str, Floats] = {
    "left": np.array([-0.03, 0.02, -0.015, 0.004]),
    "right": np.array([-0.029, 0.019, -0.014, 0.0035]),
}


def pose(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Floats:
    """(4, 4) of a rotation vector, rad, and a translation, m."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(np.array(turn, np.float64))[0], shift
    return T


T_RIGHT_LEFT = pose((0.014, -0.0004, 0.0023), (-0.11, -0.0003, 0.0002))
T_IMU: dict[str, Floats] = {"left": pose((0.3, -0.8, 0.2), (0.1, 0.05, -0.02))}
T_IMU["right"] = T_IMU["left"] @ np.linalg.inv(T_RIGHT_LEFT)
R, T = T_RIGHT_LEFT[:3, :3].copy(), T_RIGHT_LEFT[:3, 3].copy()


def four(side: str) -> list[float]:
    """fx, fy, cx, cy of an eye, px."""
    return [float(K[side][at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]


def rectified() -> tuple[dict[str, Floats], dict[str, Floats]]:
    """R (3, 3) and P (3, 4) of both eyes, as ROS and ORB-SLAM2 write them."""
    found = cv2.stereoRectify(
        *(K["left"], D["left"], K["right"], D["right"], SIZE, R, T[:, None].copy()),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )[:4]
    R1, R2, P1, P2 = (np.asarray(one, np.float64) for one in found)
    return {"left": R1, "right": R2}, {"left": P1, "right": P2}


def written(path: Path, content: Any) -> Path:
    """A file of text, or of JSON; its folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def opencv_file(path: Path, content: dict[str, Any]) -> Path:
    """What `cv2.FileStorage` writes of matrices and numbers."""
    path.parent.mkdir(parents=True, exist_ok=True)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in content.items():
        storage.write(name, value)
    storage.release()
    return path


def opencv_matrix(name: str, M: npt.ArrayLike) -> str:
    """A matrix in OpenCV's dialect of YAML, with all digits, as people copy it into settings."""
    M = np.atleast_2d(M)
    numbers = ", ".join(map(repr, M.reshape(-1).tolist()))
    return (
        f"{name}: !!opencv-matrix\n   rows: {len(M)}\n   cols: {len(M[0])}\n   dt: d\n"
        f"   data: [{numbers}]\n"
    )
