"""Files of OpenCV, of scripts around it, of data sets and of makers."""

from pathlib import Path

import numpy as np
import yaml

from fleetpose.evaluation.bench.cameras.made.known import (
    FISHEYE,
    SIDES,
    SIZE,
    T_RIGHT_LEFT,
    D,
    Floats,
    K,
    R,
    T,
    four,
    opencv_file,
    rectified,
    written,
)
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig, content_of

_NAMES = ("k1", "k2", "p1", "p2", "k3")


def ours(folder: Path) -> Path:
    """This project's own stereo.json."""
    rig = StereoRig(K["left"], D["left"], K["right"], D["right"], T_RIGHT_LEFT, SIZE)
    return written(folder / "stereo.json", content_of(rig))


def opencv_yml(folder: Path) -> Path:
    """K1, D1, K2, D2, R, T of `cv2.FileStorage`, with a map that is no matrix among them."""
    matrices = {"K1": K["left"], "D1": D["left"], "K2": K["right"], "D2": D["right"]}
    path = opencv_file(folder / "stereo.yml", matrices | {"R": R, "T": T[:, None]})
    more = "board:\n   cols: 9\n   rows: 6\nimageSize: [ 752, 480 ]\n"
    return written(path, path.read_text().removesuffix("...\n") + more)


def opencv_sample(folder: Path) -> Path:
    """intrinsics.yml and extrinsics.yml of OpenCV's own stereo_calib."""
    opencv_file(folder / "extrinsics.yml", {"R": R, "T": T[:, None]})
    matrices = {"M1": K["left"], "D1": D["left"], "M2": K["right"], "D2": D["right"]}
    return opencv_file(folder / "intrinsics.yml", matrices)


def opencv_xml(folder: Path) -> Path:
    """The same in one file of XML, under long names."""
    matrices = {"cameraMatrix1": K["left"], "distCoeffs1": D["left"]}
    matrices |= {"cameraMatrix2": K["right"], "distCoeffs2": D["right"], "R": R, "T": T[:, None]}
    return opencv_file(folder / "stereo.xml", matrices)


def named_with_letters(folder: Path) -> Path:
    """cameraMatrixL and its like, in JSON."""
    content = {"cameraMatrixL": K["left"].tolist(), "distCoeffsL": [D["left"].tolist()]}
    content |= {"cameraMatrixR": K["right"].tolist(), "distCoeffsR": [D["right"].tolist()]}
    content |= {"R": R.tolist(), "T": [[v] for v in T]}
    return written(folder / "stereo_params.json", content | {"image_size": list(SIZE), "rms": 0.2})


def named_by_words(folder: Path) -> Path:
    """camera_matrix_left, dist_coeffs_left and what `cv2.stereoRectify` gave, in JSON."""
    content = {f"camera_matrix_{side}": K[side].tolist() for side in SIDES}
    content |= {f"dist_coeffs_{side}": D[side].tolist() for side in SIDES}
    content |= {"rotation_matrix": R.tolist(), "translation_vector": T.tolist()}
    turns, projections = rectified()
    for k, side in enumerate(SIDES, 1):
        content |= {f"R{k}": turns[side].tolist(), f"P{k}": projections[side].tolist()}
    return written(
        folder / "calibration.json",
        content | {"Q": np.eye(4).tolist(), "imageWidth": 752, "imageHeight": 480},
    )


def named_in_sections(folder: Path) -> Path:
    """A section of YAML for each eye and one for what joins them."""
    content: dict = {side: {"K": K[side].tolist(), "D": D[side].tolist()} for side in SIDES}
    content["stereo"] = {"R": R.tolist(), "T": T.tolist()}
    return written(folder / "rig.yaml", yaml.safe_dump(content | {"width": 752, "height": 480}))


def numbered_from_zero(folder: Path) -> Path:
    """K0 and K1, with numpy's shape."""
    content = {f"K{k}": K[side].tolist() for k, side in enumerate(SIDES)}
    content |= {f"dist{k}": D[side].tolist() for k, side in enumerate(SIDES)}
    content |= {"R": R.tolist(), "T": T.tolist(), "shape": [480, 752]}
    return written(folder / "rig.json", content)


def opencv_fisheye(folder: Path) -> Path:
    """`cv2.fisheye.stereoCalibrate` under its own names, and said to be so."""
    content = {f"K{k}": K[side].tolist() for k, side in enumerate(SIDES, 1)}
    content |= {f"D{k}": [[v] for v in FISHEYE[side]] for k, side in enumerate(SIDES, 1)}
    content |= {"R": R.tolist(), "T": T.tolist(), "image_size": list(SIZE), "model": "fisheye"}
    return written(folder / "fisheye.json", content)


def ros(folder: Path) -> Path:
    """left.yaml and right.yaml of `camera_calibration`."""
    turns, projections = rectified()
    for side in SIDES:
        matrices = {"camera_matrix": K[side], "distortion_coefficients": D[side][None]}
        matrices |= {"rectification_matrix": turns[side], "projection_matrix": projections[side]}
        content: dict = {"image_width": 752, "image_height": 480, "distortion_model": "plumb_bob"}
        for name, M in matrices.items():
            content[name] = {"rows": len(M), "cols": len(M[0]), "data": M.reshape(-1).tolist()}
        written(folder / f"{side}.yaml", yaml.safe_dump(content | {"camera_name": side}))
    return folder / "left.yaml"


def ros_echo(folder: Path) -> Path:
    """`ros2 topic echo --once` of both camera_info, of ROS 2; its end is a line of dashes."""
    turns, projections = rectified()
    for side in SIDES:
        content: dict = {"header": {"frame_id": side}, "height": 480, "width": 752}
        content |= {"distortion_model": "plumb_bob", "d": D[side].tolist()}
        content |= {"k": K[side].reshape(-1).tolist(), "r": turns[side].reshape(-1).tolist()}
        content |= {"p": projections[side].reshape(-1).tolist(), "binning_x": 0}
        written(folder / f"{side}_info.yaml", yaml.safe_dump(content) + "---\n")
    return folder / "left_info.yaml"


def kitti(folder: Path) -> Path:
    """calib.txt of KITTI's odometry: rectified images, f times the baseline in the last column."""
    f, _, cx, cy = four("left")
    rows = [[f, 0, cx, x, 0, f, cy, 0, 0, 0, 1, 0] for x in (0.0, -0.11 * f, 0.03 * f, -0.08 * f)]
    lines = [f"P{k}: " + " ".join(map(repr, map(float, row))) for k, row in enumerate(rows)]
    return written(folder / "calib.txt", "\n".join(lines) + "\n")


def kitti_raw(folder: Path) -> Path:
    """calib_cam_to_cam.txt of KITTI's raw recordings."""
    f, _, cx, cy = four("left")
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.95e-02"]
    for k, x in enumerate((0.0, -0.11 * f)):
        row = [f, 0, cx, x, 0, f, cy, 0, 0, 0, 1, 0]
        lines += [f"S_{k:02}: 1392 512", f"K_{k:02}: 984.2 0 690 0 980.8 233.2 0 0 1"]
        lines += [f"D_{k:02}: -0.37 0.2 0.001 0.002 -0.07", f"T_{k:02}: {-0.11 * k} 0 0"]
        lines += [f"R_{k:02}: 1 0 0 0 1 0 0 0 1", f"R_rect_{k:02}: 1 0 0 0 1 0 0 0 1"]
        lines += [f"S_rect_{k:02}: 752 480"]
        lines += [f"P_rect_{k:02}: " + " ".join(map(repr, map(float, row)))]
    return written(folder / "calib_cam_to_cam.txt", "\n".join(lines) + "\n")


def middlebury(folder: Path) -> Path:
    """calib.txt of Middlebury 2014, which ETH3D's two-view stereo has as well: millimetres."""
    f, _, cx, cy = four("left")
    lines = [f"cam{k}=[{f} 0 {x}; 0 {f} {cy}; 0 0 1]" for k, x in enumerate((cx, cx + 12.5))]
    lines += ["doffs=12.5", "baseline=110.0", "width=752", "height=480", "ndisp=128", "isint=0"]
    return written(folder / "calib.txt", "\n".join(lines) + "\n")


def zed(folder: Path, mode: str = "", name: str = "SN12345678.conf") -> Path:
    """Stereolabs' file: millimetres, and angles of the right eye at each size."""
    angles = (0.014, -0.0004, 0.0023)
    lines = []
    for suffix, scale in (("VGA", 0.5), ("HD", 1.0)):
        for side in SIDES:
            fx, fy, cx, cy = (scale * v for v in (700.0, 701.0, 640.5, 361.5))
            lines += [f"[{side.upper()}_CAM_{suffix}]", f"fx={fx}", f"fy={fy}", f"cx={cx}"]
            lines += [f"cy={cy}"]
            lines += [f"{n}={v}" for n, v in zip(_NAMES, D[side].tolist(), strict=True)] + [""]
    lines += ["[STEREO]", "Baseline=110.0", f"TY{mode}=0.3", f"TZ{mode}=-0.2"]
    for suffix in ("VGA", "HD"):
        lines += [f"{n}_{suffix}={v}" for n, v in zip(("RX", "CV", "RZ"), angles, strict=True)]
    return written(folder / name, "\n".join(lines) + "\n")


def oak(folder: Path) -> Path:
    """What Luxonis' devices hold: centimetres, each camera joined to the next."""

    def camera(side: str, to: int, T_next: Floats) -> dict:
        shift = dict(zip("xyz", (100 * T_next[:3, 3]).tolist(), strict=True))
        joined = {"rotationMatrix": T_next[:3, :3].tolist(), "toCameraSocket": to}
        lens = {"intrinsicMatrix": K[side].tolist(), "distortionCoeff": [*D[side], *[0.0] * 9]}
        return {
            "cameraType": 0,
            "width": 752,
            "height": 480,
            "extrinsics": joined | {"translation": shift},
        } | lens

    cameras = [[1, camera("left", 2, T_RIGHT_LEFT)], [2, camera("right", -1, np.eye(4))]]
    pair = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    return written(folder / "oak.json", {"cameraData": cameras, "stereoRectificationData": pair})


def realsense(folder: Path) -> Path:
    """A dump of an Intel RealSense, of which no two are alike."""
    lens = {"width": 752, "height": 480, "ppx": 367.0, "ppy": 248.0, "fx": 459.0, "fy": 459.0}
    streams = [{"name": f"Infrared {k}", "intrinsics": lens} for k in (1, 2)]
    return written(folder / "realsense.json", {"device": {"name": "D435"}, "streams": streams})


def eth3d(folder: Path) -> Path:
    """ETH3D's SLAM stereo: a file of numbers for each eye, and one that joins them."""
    for name, side in (("calibration.txt", "left"), ("calibration2.txt", "right")):
        written(folder / name, " ".join(map(repr, four(side))) + "\n")
    rows = [" ".join(map(repr, row)) for row in np.linalg.inv(T_RIGHT_LEFT)[:3].tolist()]
    written(folder / "extrinsics_1_2.txt", "\n".join(rows) + "\n")
    return folder / "calibration.txt"
