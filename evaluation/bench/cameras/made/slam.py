"""Files of tools for cameras on robots: Kalibr and what reads it, ORB-SLAM, VINS-Fusion, Basalt."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from fleetpose.evaluation.bench.cameras.made.known import (
    FISHEYE,
    SIDES,
    SIZE,
    T_IMU,
    T_RIGHT_LEFT,
    D,
    K,
    four,
    opencv_matrix,
    rectified,
    written,
)

_LENS = ("fx", "fy", "cx", "cy")
_NORMAL = ("k1", "k2", "p1", "p2", "k3")
_KB = ("k1", "k2", "k3", "k4")


def _camera(side: str, fisheye: bool = False, **more: Any) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "resolution": list(SIZE),
        "intrinsics": four(side),
        "distortion_model": "equidistant" if fisheye else "radtan",
        "distortion_coeffs": (FISHEYE if fisheye else D)[side][:4].tolist(),
        "rostopic": f"/{side}/image_raw",
        **more,
    }


def kalibr(folder: Path, fisheye: bool = False) -> Path:
    """Kalibr's camchain, with a byte order mark and OpenCV's header, as editors and people add."""
    cameras = {
        "cam0": _camera("left", fisheye),
        "cam1": _camera("right", fisheye, T_cn_cnm1=T_RIGHT_LEFT.tolist()),
    }
    return written(folder / "camchain.yaml", "\ufeff%YAML:1.0\n" + yaml.safe_dump(cameras))


def kalibr_equi(folder: Path) -> Path:
    """The same of fisheye lenses."""
    return kalibr(folder, fisheye=True)


def kalibr_in_ros(folder: Path) -> Path:
    """The same among the parameters of a ROS 2 node."""
    cameras = yaml.safe_load(kalibr(folder).read_text("utf-8-sig").removeprefix("%YAML:1.0\n"))
    return written(folder / "params.yaml", yaml.safe_dump({"/**": {"ros__parameters": cameras}}))


def kalibr_imu(folder: Path) -> Path:
    """Cameras on an IMU (T_cam_imu), nothing between them."""
    cameras = {
        f"cam{k}": _camera(side, T_cam_imu=np.linalg.inv(T_IMU[side]).tolist())
        for k, side in enumerate(SIDES)
    }
    return written(folder / "camchain-imucam.yaml", yaml.safe_dump(cameras))


def openvins(folder: Path) -> Path:
    """OpenVINS: T_imu_cam of both, nothing between them."""
    cameras = {
        f"cam{k}": _camera(side, T_imu_cam=T_IMU[side].tolist()) for k, side in enumerate(SIDES)
    }
    return written(folder / "kalibr_imucam_chain.yaml", "%YAML:1.0\n" + yaml.safe_dump(cameras))


def orbslam2(folder: Path) -> Path:
    """LEFT.K and its like."""
    turns, projections = rectified()
    text = "%YAML:1.0\n\nCamera.fx: 435.2\nCamera.fy: 435.2\nCamera.bf: 47.9\n"
    for side in SIDES:
        eye = side.upper()
        text += f"{eye}.width: 752\n{eye}.height: 480\n"
        named = {"K": K[side], "D": D[side], "R": turns[side], "P": projections[side]}
        for name, M in named.items():
            text += opencv_matrix(f"{eye}.{name}", M).replace("data: [", "data:[")
    return written(folder / "EuRoC.yaml", text)


def orbslam2_rectified(folder: Path) -> Path:
    """Rectified images, by Camera.fx and Camera.bf."""
    f, _, cx, cy = four("left")
    lines = [f"Camera.{n}: {v!r}" for n, v in zip(_LENS, (f, f, cx, cy), strict=True)]
    lines += [f"Camera.{n}: 0.0" for n in _NORMAL[:4]]
    lines += [f"Camera.bf: {0.11 * f!r}", "Camera.width: 752", "Camera.height: 480", "ThDepth: 35"]
    return written(folder / "KITTI.yaml", "%YAML:1.0\n\n" + "\n".join(lines) + "\n")


def orbslam3(folder: Path, kind: str = "PinHole") -> Path:
    """Camera1, Camera2 and Stereo.T_c1_c2."""
    names, values = (_NORMAL, D) if kind == "PinHole" else (_KB, FISHEYE)
    lines = ["%YAML:1.0", "", 'File.version: "1.0"', f'Camera.type: "{kind}"']
    for k, side in enumerate(SIDES, 1):
        numbers = [*four(side), *values[side].tolist()]
        lines += [f"Camera{k}.{n}: {v!r}" for n, v in zip((*_LENS, *names), numbers, strict=True)]
    lines += ["Camera.width: 752", "Camera.height: 480", "Camera.fps: 20", ""]
    text = "\n".join(lines) + opencv_matrix("Stereo.T_c1_c2", np.linalg.inv(T_RIGHT_LEFT))
    return written(folder / "orbslam3.yaml", text)


def orbslam3_fisheye(folder: Path) -> Path:
    """The same of KannalaBrandt8."""
    return orbslam3(folder, "KannalaBrandt8")


def euroc(folder: Path) -> Path:
    """sensor.yaml of both cameras below mav0."""
    for k, side in enumerate(SIDES):
        content = _camera(side, sensor_type="camera", rate_hz=20)
        content["distortion_model"] = "radial-tangential"
        content["distortion_coefficients"] = content.pop("distortion_coeffs")
        content["T_BS"] = {"cols": 4, "rows": 4, "data": T_IMU[side].reshape(-1).tolist()}
        written(folder / f"mav0/cam{k}/sensor.yaml", yaml.safe_dump(content))
    return folder / "mav0/cam0/sensor.yaml"


def kimera(folder: Path) -> Path:
    """Kimera-VIO's LeftCameraParams.yaml and RightCameraParams.yaml."""
    for side in SIDES:
        content = _camera(side, camera_id=side)
        content["distortion_coefficients"] = content.pop("distortion_coeffs")
        content["T_BS"] = {"cols": 4, "rows": 4, "data": T_IMU[side].reshape(-1).tolist()}
        text = "%YAML:1.0\n" + yaml.safe_dump(content)
        written(folder / f"{side.capitalize()}CameraParams.yaml", text)
    return folder / "LeftCameraParams.yaml"


def okvis(folder: Path) -> Path:
    """OKVIS: a list of cameras on a sensor (T_SC)."""
    cameras = [
        {
            "T_SC": T_IMU[side].reshape(-1).tolist(),
            "image_dimension": list(SIZE),
            "distortion_coefficients": D[side][:4].tolist(),
            "distortion_type": "radialtangential",
            "focal_length": four(side)[:2],
            "principal_point": four(side)[2:],
        }
        for side in SIDES
    ]
    return written(folder / "okvis.yaml", "%YAML:1.0\n" + yaml.safe_dump({"cameras": cameras}))


def maplab(folder: Path) -> Path:
    """maplab's and SVO's ncamera: a list of cameras on a body (T_B_C)."""
    cameras = [
        {
            "camera": {
                "label": side,
                "type": "pinhole",
                "image_width": SIZE[0],
                "image_height": SIZE[1],
                "intrinsics": {"rows": 4, "cols": 1, "data": four(side)},
                "distortion": {
                    "type": "radial-tangential",
                    "parameters": {"rows": 4, "cols": 1, "data": D[side][:4].tolist()},
                },
            },
            "T_B_C": {"rows": 4, "cols": 4, "data": T_IMU[side].reshape(-1).tolist()},
        }
        for side in SIDES
    ]
    return written(folder / "ncamera.yaml", yaml.safe_dump({"label": "rig", "cameras": cameras}))


def vins(folder: Path, fisheye: bool = False) -> Path:
    """VINS-Fusion's configuration, with camodocal's cameras beside it."""
    text = "%YAML:1.0\n"
    for k, side in enumerate(SIDES):
        text += f'cam{k}_calib: "cam{k}.yaml"\n' + opencv_matrix(f"body_T_cam{k}", T_IMU[side])
        camera: dict[str, Any] = {"image_width": 752, "image_height": 480}
        if fisheye:
            names = ("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0")
            numbers = [*FISHEYE[side].tolist(), *four(side)]
            camera["model_type"] = "KANNALA_BRANDT"
            camera["projection_parameters"] = dict(zip(names, numbers, strict=True))
        else:
            camera["model_type"] = "PINHOLE"
            lens = dict(zip(_NORMAL[:4], D[side][:4].tolist(), strict=True))
            camera["distortion_parameters"] = lens
            camera["projection_parameters"] = dict(zip(_LENS, four(side), strict=True))
        written(folder / f"cam{k}.yaml", "%YAML:1.0\n---\n" + yaml.safe_dump(camera))
    return written(folder / "stereo_config.yaml", text)


def vins_fisheye(folder: Path) -> Path:
    """The same of KANNALA_BRANDT."""
    return vins(folder, fisheye=True)


def basalt(folder: Path, kind: str = "pinhole-radtan8") -> Path:
    """Basalt's calibration.json."""
    poses = [
        dict(zip(("px", "py", "pz"), T_IMU[s][:3, 3].tolist(), strict=True)) | _quaternion(s)
        for s in SIDES
    ]
    names, values = ((*_NORMAL, "k4", "k5", "k6"), D) if kind != "kb4" else (_KB, FISHEYE)
    cameras = []
    for side in SIDES:
        numbers = [*four(side), *values[side].tolist(), 0.0, 0.0, 0.0][: 4 + len(names)]
        lens = dict(zip((*_LENS, *names), numbers, strict=True))
        cameras.append({"camera_type": kind, "intrinsics": lens})
    value = {"T_imu_cam": poses, "intrinsics": cameras, "resolution": [list(SIZE), list(SIZE)]}
    return written(folder / "calibration.json", {"value0": value})


def basalt_kb4(folder: Path) -> Path:
    """The same of fisheye lenses."""
    return basalt(folder, "kb4")


def basalt_double_sphere(folder: Path) -> Path:
    """The same of a model that is not supported."""
    return basalt(folder, "ds")


def _quaternion(side: str) -> dict[str, float]:
    turn = cv2.Rodrigues(T_IMU[side][:3, :3])[0].ravel()
    angle = float(np.linalg.norm(turn))
    x, y, z = (np.sin(angle / 2) * turn / angle).tolist()
    return {"qx": x, "qy": y, "qz": z, "qw": float(np.cos(angle / 2))}
