"""One rig in the files of many tools: each is read as the same rig, or refused by its name."""

import json

import cv2
import numpy as np
import pytest
import yaml

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig, read_rig_file
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig, content_of

SIZE = (752, 480)
K = {
    "left": np.array([[459.0, 0, 367], [0, 457, 248], [0, 0, 1]]),
    "right": np.array([[457.0, 0, 380], [0, 456, 255], [0, 0, 1]]),
}
D = {
    "left": np.array([-0.283, 0.074, 0.0002, 0.00002, 0.01]),
    "right": np.array([-0.284, 0.0745, -0.0001, -0.00004, 0.02]),
}
FISHEYE = {
    "left": np.array([-0.03, 0.02, -0.015, 0.004]),
    "right": np.array([-0.029, 0.019, -0.014, 0.0035]),
}
SIDES = ("left", "right")


def turn(*vector):
    return np.asarray(cv2.Rodrigues(np.array(vector))[0])


def pose(R, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


T_RIGHT_LEFT = pose(turn(0.014, -0.0004, 0.0023), [-0.11, -0.0003, 0.0002])
T_IMU = {"left": pose(turn(0.3, -0.8, 0.2), [0.1, 0.05, -0.02])}
T_IMU["right"] = T_IMU["left"] @ np.linalg.inv(T_RIGHT_LEFT)


def four(side):
    return D[side][:4].tolist()


def opencv(path, matrices):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in matrices.items():
        storage.write(name, value)
    storage.release()
    return path


def text(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def camera_yaml(**more):
    return {"camera_model": "pinhole", "resolution": list(SIZE), **more}


def pinhole(side):
    return [float(K[side][at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]


def kalibr_camera(side, **more):
    return camera_yaml(
        intrinsics=pinhole(side), distortion_model="radtan", distortion_coeffs=four(side), **more
    )


def rectified(D_left=D["left"], D_right=D["right"]):
    """What ROS and ORB-SLAM2 write of a rig: R and P of both eyes."""
    return cv2.stereoRectify(
        *(K["left"], D_left, K["right"], D_right, SIZE),
        *(T_RIGHT_LEFT[:3, :3].copy(), T_RIGHT_LEFT[:3, 3:].copy()),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )[:4]


def ours(folder):
    rig = StereoRig(K["left"], D["left"], K["right"], D["right"], T_RIGHT_LEFT, SIZE)
    return text(folder / "stereo.json", content_of(rig))


def opencv_yml(folder):
    matrices = {"K1": K["left"], "D1": D["left"], "K2": K["right"], "D2": D["right"]}
    matrices |= {"R": T_RIGHT_LEFT[:3, :3].copy(), "T": T_RIGHT_LEFT[:3, 3:].copy()}
    path = opencv(folder / "stereo.yml", matrices)
    return text(
        path,
        path.read_text().removesuffix("...\n")
        + "board:\n   cols: 9\n   rows: 6\nimageSize: [ 752, 480 ]\n",
    )


def opencv_xml_of_two(folder):
    opencv(
        folder / "extrinsics.xml",
        {"R": T_RIGHT_LEFT[:3, :3].copy(), "T": T_RIGHT_LEFT[:3, 3:].copy()},
    )
    matrices = {"M1": K["left"], "D1": D["left"], "M2": K["right"], "D2": D["right"]}
    return opencv(folder / "intrinsics.xml", matrices)


def named_with_letters(folder):
    content = {"cameraMatrixL": K["left"].tolist(), "distCoeffsL": [D["left"].tolist()]}
    content |= {"cameraMatrixR": K["right"].tolist(), "distCoeffsR": [D["right"].tolist()]}
    content |= {"R": T_RIGHT_LEFT[:3, :3].tolist(), "T": [[v] for v in T_RIGHT_LEFT[:3, 3]]}
    return text(folder / "stereo_params.json", content | {"image_size": list(SIZE), "rms": 0.2})


def named_by_words(folder):
    content = {f"camera_matrix_{side}": K[side].tolist() for side in SIDES}
    content |= {f"dist_coeffs_{side}": D[side].tolist() for side in SIDES}
    content |= {"rotation_matrix": T_RIGHT_LEFT[:3, :3].tolist()}
    content |= {"translation_vector": T_RIGHT_LEFT[:3, 3].tolist()}
    R1, R2, P1, P2 = (one.tolist() for one in rectified())
    content |= {"R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": np.eye(4).tolist()}
    return text(folder / "calibration.json", content | {"imageWidth": 752, "imageHeight": 480})


def named_in_sections(folder):
    content = {side: {"K": K[side].tolist(), "D": D[side].tolist()} for side in SIDES}
    content["stereo"] = {"R": T_RIGHT_LEFT[:3, :3].tolist(), "T": T_RIGHT_LEFT[:3, 3].tolist()}
    return text(folder / "rig.yaml", yaml.safe_dump(content | {"width": 752, "height": 480}))


def numbered_from_zero(folder):
    content = {f"K{k}": K[side].tolist() for k, side in enumerate(SIDES)}
    content |= {f"dist{k}": D[side].tolist() for k, side in enumerate(SIDES)}
    content |= {"R": T_RIGHT_LEFT[:3, :3].tolist(), "T": T_RIGHT_LEFT[:3, 3].tolist()}
    return text(folder / "rig.json", content | {"shape": [480, 752]})


def kalibr(folder):
    cameras = {"cam0": kalibr_camera("left")}
    cameras["cam1"] = kalibr_camera("right", T_cn_cnm1=T_RIGHT_LEFT.tolist())
    return text(folder / "camchain.yaml", "\ufeff%YAML:1.0\n" + yaml.safe_dump(cameras))


def kalibr_in_ros(folder):
    cameras = {"cam0": kalibr_camera("left")}
    cameras["cam1"] = kalibr_camera("right", T_cn_cnm1=T_RIGHT_LEFT.tolist())
    return text(folder / "params.yaml", yaml.safe_dump({"/**": {"ros__parameters": cameras}}))


def kalibr_imu(folder):
    cameras = {
        f"cam{k}": kalibr_camera(side, T_cam_imu=np.linalg.inv(T_IMU[side]).tolist())
        for k, side in enumerate(SIDES)
    }
    return text(folder / "camchain-imucam.yaml", yaml.safe_dump(cameras))


def openvins(folder):
    cameras = {
        f"cam{k}": kalibr_camera(side, T_imu_cam=T_IMU[side].tolist())
        for k, side in enumerate(SIDES)
    }
    return text(folder / "kalibr_imucam_chain.yaml", "%YAML:1.0\n" + yaml.safe_dump(cameras))


def ros(folder):
    R1, R2, P1, P2 = rectified()
    for side, R, P in (("left", R1, P1), ("right", R2, P2)):
        matrices = {"camera_matrix": K[side], "distortion_coefficients": D[side][None]}
        matrices |= {"rectification_matrix": R, "projection_matrix": P}
        content: dict = {"image_width": 752, "image_height": 480, "distortion_model": "plumb_bob"}
        for name, M in matrices.items():
            content[name] = {"rows": len(M), "cols": len(M[0]), "data": M.reshape(-1).tolist()}
        text(folder / f"{side}.yaml", yaml.safe_dump(content))
    return folder / "left.yaml"


def orbslam2(folder):
    R1, R2, P1, P2 = rectified()
    lines = ["%YAML:1.0", "", "Camera.fx: 435.2", "Camera.fy: 435.2", "Camera.bf: 47.9"]
    for side, R, P in (("left", R1, P1), ("right", R2, P2)):
        lines += [f"{side.upper()}.width: 752", f"{side.upper()}.height: 480"]
        for name, M in (("K", K[side]), ("D", D[side][None]), ("R", R), ("P", P)):
            lines += [f"{side.upper()}.{name}: !!opencv-matrix", f"   rows: {len(M)}"]
            numbers = ", ".join(map(repr, M.reshape(-1).tolist()))
            lines += [f"   cols: {len(M[0])}", "   dt: d", f"   data:[{numbers}]"]
    return text(folder / "EuRoC.yaml", "\n".join(lines) + "\n")


def orbslam3(folder):
    lines = ["%YAML:1.0", "", 'File.version: "1.0"', 'Camera.type: "PinHole"']
    for k, side in ((1, "left"), (2, "right")):
        for name, value in zip(("fx", "fy", "cx", "cy"), pinhole(side), strict=True):
            lines.append(f"Camera{k}.{name}: {value!r}")
        for name, value in zip(("k1", "k2", "p1", "p2", "k3"), D[side].tolist(), strict=True):
            lines.append(f"Camera{k}.{name}: {value!r}")
    numbers = ", ".join(map(repr, np.linalg.inv(T_RIGHT_LEFT).reshape(-1).tolist()))
    lines += ["Camera.width: 752", "Camera.height: 480", "Stereo.T_c1_c2: !!opencv-matrix"]
    lines += ["  rows: 4", "  cols: 4", "  dt: f", f"  data: [{numbers}]"]
    return text(folder / "orb.yaml", "\n".join(lines) + "\n")


def euroc(folder):
    for k, side in enumerate(SIDES):
        content = camera_yaml(intrinsics=pinhole(side), distortion_model="radial-tangential")
        content |= {"distortion_coefficients": D[side].tolist(), "sensor_type": "camera"}
        content["T_BS"] = {"cols": 4, "rows": 4, "data": T_IMU[side].reshape(-1).tolist()}
        text(folder / f"mav0/cam{k}/sensor.yaml", yaml.safe_dump(content))
    return folder / "mav0/cam0/sensor.yaml"


def vins(folder):
    lines = ["%YAML:1.0", 'cam0_calib: "cam0_pinhole.yaml"', 'cam1_calib: "cam1_pinhole.yaml"']
    for k, side in enumerate(SIDES):
        numbers = ", ".join(map(repr, T_IMU[side].reshape(-1).tolist()))
        lines += [f"body_T_cam{k}: !!opencv-matrix", "   rows: 4", "   cols: 4", "   dt: d"]
        lines += [f"   data: [{numbers}]"]
        fx, fy, cx, cy = pinhole(side)
        k1, k2, p1, p2 = four(side)
        camera = {"model_type": "PINHOLE", "image_width": 752, "image_height": 480}
        camera["distortion_parameters"] = {"k1": k1, "k2": k2, "p1": p1, "p2": p2}
        camera["projection_parameters"] = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
        text(folder / f"cam{k}_pinhole.yaml", "%YAML:1.0\n---\n" + yaml.safe_dump(camera))
    return text(folder / "euroc_stereo_config.yaml", "\n".join(lines) + "\n")


def quaternion(R):
    w = np.sqrt(1 + np.trace(R)) / 2
    off = R - R.T
    return {"qx": off[2, 1] / 4 / w, "qy": off[0, 2] / 4 / w, "qz": off[1, 0] / 4 / w, "qw": w}


def basalt(folder):
    poses = [
        dict(zip(("px", "py", "pz"), T_IMU[s][:3, 3], strict=True)) | quaternion(T_IMU[s][:3, :3])
        for s in SIDES
    ]
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    cameras = [
        {
            "camera_type": "pinhole-radtan8",
            "intrinsics": dict(zip(("fx", "fy", "cx", "cy"), pinhole(side), strict=True))
            | dict(zip(names, [*D[side].tolist(), 0, 0, 0], strict=True)),
        }
        for side in SIDES
    ]
    value = {"T_imu_cam": poses, "intrinsics": cameras, "resolution": [list(SIZE), list(SIZE)]}
    return text(folder / "calibration.json", {"value0": value})


def oak(folder):
    def camera(side, to, T):
        shift = dict(zip("xyz", (100 * T[:3, 3]).tolist(), strict=True))
        joined = {"rotationMatrix": T[:3, :3].tolist(), "toCameraSocket": to, "translation": shift}
        lens = {"intrinsicMatrix": K[side].tolist(), "distortionCoeff": [*D[side], *[0.0] * 9]}
        return {"cameraType": 0, "width": 752, "height": 480, "extrinsics": joined} | lens

    cameras = [[1, camera("left", 2, T_RIGHT_LEFT)], [2, camera("right", -1, np.eye(4))]]
    pair = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    return text(folder / "oak.json", {"cameraData": cameras, "stereoRectificationData": pair})


@pytest.mark.parametrize(
    "write",
    [
        *(ours, opencv_yml, opencv_xml_of_two, named_with_letters, named_by_words),
        *(named_in_sections, numbered_from_zero, kalibr, kalibr_in_ros, kalibr_imu, openvins),
        *(ros, orbslam2, orbslam3, euroc, vins, basalt, oak),
    ],
)
def test_a_rig_is_the_same_from_the_files_of_every_tool(write, tmp_path):
    rig = read_rig_file(write(tmp_path), SIZE)
    assert (rig.lens, rig.size) == ("normal", SIZE)
    np.testing.assert_allclose(rig.T_right_left, T_RIGHT_LEFT, atol=1e-9)
    for side in SIDES:
        np.testing.assert_allclose(getattr(rig, f"K_{side}"), K[side], atol=1e-9)
        found = getattr(rig, f"D_{side}")
        length = min(len(found), 5)
        np.testing.assert_allclose(found[:length], D[side][:length], atol=1e-12)
        assert not found[length:].any()


def kalibr_equi(folder):
    cameras = {
        f"cam{k}": camera_yaml(
            intrinsics=pinhole(side),
            distortion_model="equidistant",
            distortion_coeffs=FISHEYE[side].tolist(),
        )
        for k, side in enumerate(SIDES)
    }
    cameras["cam1"]["T_cn_cnm1"] = T_RIGHT_LEFT.tolist()
    return text(folder / "camchain.yaml", yaml.safe_dump(cameras))


def orbslam3_fisheye(folder):
    lines = ["%YAML:1.0", "", 'Camera.type: "KannalaBrandt8"']
    for k, side in ((1, "left"), (2, "right")):
        for name, value in zip(("fx", "fy", "cx", "cy"), pinhole(side), strict=True):
            lines.append(f"Camera{k}.{name}: {value!r}")
        for number, value in enumerate(FISHEYE[side].tolist(), 1):
            lines.append(f"Camera{k}.k{number}: {value!r}")
    numbers = ", ".join(map(repr, np.linalg.inv(T_RIGHT_LEFT).reshape(-1).tolist()))
    lines += ["Stereo.T_c1_c2: !!opencv-matrix", "  rows: 4", "  cols: 4", f"  data: [{numbers}]"]
    return text(folder / "orb.yaml", "\n".join(lines) + "\n")


def basalt_kb4(folder):
    path = basalt(folder)
    content = json.loads(path.read_text())
    for side, camera in zip(SIDES, content["value0"]["intrinsics"], strict=True):
        camera["camera_type"] = "kb4"
        camera["intrinsics"] |= dict(zip(("k1", "k2", "k3", "k4"), FISHEYE[side], strict=True))
    return text(path, content)


def opencv_fisheye(folder):
    content = {
        f"K{k}": np.diag([0.5, 0.5, 1]).dot(K[side]).tolist()
        for k, side in ((1, "left"), (2, "right"))
    }
    content = {
        name: [[280.0, 0, row[0][2] + 184], [0, 280.0, row[1][2] + 124], [0, 0, 1]]
        for name, row in content.items()
    }
    content |= {f"D{k}": [[v] for v in FISHEYE[side]] for k, side in ((1, "left"), (2, "right"))}
    content |= {"R": T_RIGHT_LEFT[:3, :3].tolist(), "T": T_RIGHT_LEFT[:3, 3].tolist()}
    return text(folder / "stereo.json", content | {"image_width": 752, "image_height": 480})


@pytest.mark.parametrize("write", [kalibr_equi, orbslam3_fisheye, basalt_kb4, opencv_fisheye])
def test_a_fisheye_is_known_as_one(write, tmp_path):
    rig = read_rig_file(write(tmp_path), SIZE)
    assert rig.lens == "fisheye"
    np.testing.assert_allclose(rig.T_right_left, T_RIGHT_LEFT, atol=1e-9)
    for side in SIDES:
        np.testing.assert_allclose(getattr(rig, f"D_{side}"), FISHEYE[side], atol=1e-12)


def test_four_numbers_that_may_be_either_lens_are_refused(tmp_path):
    content = json.loads(opencv_fisheye(tmp_path).read_text())
    content |= {"D1": [-0.03, 0.02, 0.001, 0.0001], "D2": [-0.03, 0.02, 0.001, 0.0]}
    with pytest.raises(CalibrationError, match=r"4 numbers .*distortion_model"):
        read_rig_file(text(tmp_path / "stereo.json", content), SIZE)
    content["distortion_model"] = "radtan"
    assert read_rig_file(text(tmp_path / "stereo.json", content), SIZE).lens == "normal"


@pytest.mark.parametrize("unit", [0.001, 0.01, 0.0333])
def test_a_translation_in_another_unit_is_asked_for_and_told(unit, tmp_path):
    content = json.loads(ours(tmp_path).read_text())
    content["t"] = (T_RIGHT_LEFT[:3, 3] / unit).tolist()
    path = text(tmp_path / "stereo.json", content)
    with pytest.raises(CalibrationError, match="--translation-unit"):
        read_rig(tmp_path, SIZE)
    np.testing.assert_allclose(
        read_rig_file(path, SIZE, unit).T_right_left, T_RIGHT_LEFT, atol=1e-9
    )


def test_rectified_images_of_data_sets(tmp_path):
    P = "7e+02 0 6e+02 {} 0 7e+02 1.8e+02 0 0 0 1 0"
    lines = [f"P{k}: {P.format(x)}" for k, x in enumerate((0, -378.0, 35.0, -343.0))]
    kitti = read_rig_file(text(tmp_path / "calib.txt", "\n".join(lines)), (1241, 376))
    assert kitti.is_rectified and kitti.baseline_m == pytest.approx(0.54)
    lines = ["cam0=[1000 0 700; 0 1000 500; 0 0 1]", "cam1=[1000 0 730; 0 1000 500; 0 0 1]"]
    lines += ["doffs=30", "baseline=200", "width=1400", "height=1000"]
    middlebury = read_rig_file(text(tmp_path / "m.txt", "\n".join(lines)))
    assert middlebury.size == (1400, 1000) and middlebury.baseline_m == pytest.approx(0.2)
    assert middlebury.K_right[0, 2] - middlebury.K_left[0, 2] == 30


def test_a_zed_has_its_rig_at_the_size_of_the_images(tmp_path):
    sections = ""
    for mode, scale in (("HD", 2), ("VGA", 1)):
        for side in ("LEFT", "RIGHT"):
            sections += f"[{side}_CAM_{mode}]\nfx={350 * scale}\nfy={350 * scale}\n"
            sections += f"cx={336 * scale}\ncy={188 * scale}\nk1=-0.17\nk2=0.02\n"
    sections += "[STEREO]\nBaseline=120\nTY=0.1\nTZ=-0.2\nRX_VGA=0.001\nCV_VGA=0.002\nRZ_VGA=0\n"
    path = text(tmp_path / "SN1234.conf", sections)
    rig = read_rig(tmp_path, (672, 376))
    assert rig.K_left[0, 0] == 350 and rig.D_left[0] == -0.17
    assert rig.T_right_left[0, 3] == -0.12
    with pytest.raises(CalibrationError, match=r"ZED.*1280x720, 672x376"):
        read_rig_file(path, (640, 480))


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        (
            "left.yaml",
            {"camera_matrix": {}, "projection_matrix": {}},
            "ROS camera_info.*right.yaml",
        ),
        ("c.yaml", {"model_type": "MEI", "projection_parameters": {}}, "camodocal"),
        ("rs.json", {"device": {}, "streams": []}, "RealSense"),
        ("oak.json", {"cameraData": [], "stereoRectificationData": {}}, "OAK"),
        ("orb.yaml", {"LEFT.K": [1], "Camera.fx": 1}, "ORB-SLAM2"),
        ("b.json", {"value0": {"T_imu_cam": [], "intrinsics": []}}, "Basalt"),
        ("what.json", {"hello": 1}, "no calibration of a known tool"),
    ],
)
def test_what_is_not_whole_is_refused_by_its_tools_name(name, content, says, tmp_path):
    with pytest.raises(CalibrationError, match=says):
        read_rig_file(text(tmp_path / name, content), SIZE)
