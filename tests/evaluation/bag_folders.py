"""The made-up room in the bags of known benchmarks, their topics, stamps and truths as they are."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from fleetpose.formats.tum import write_tum
from tests.evaluation.folder_makers import BASELINE_M, CX, CY, HEIGHT, STEP_NS, WIDTH, F, rendered
from tests.rosmsg.bag_makers import BEGIN_NS, Maker

LATE_NS = 170 * 10**9  # Kimera-Multi's recorder, beside its headers
K = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1.0]])
P_RIGHT = np.hstack((K, [[-F * BASELINE_M], [0], [0]]))


def stereo(bag, topics, poses, packed, infos=(), late_ns=0, stamp_late_ns=0):
    """Both eyes of a robot at each pose."""
    for k, T in enumerate(poses):
        at_ns = BEGIN_NS + k * STEP_NS
        right = T.copy()
        right[:3, 3] += BASELINE_M * T[:3, 0]
        for eye, (topic, pose) in enumerate(zip(topics, (T, right), strict=True)):
            image, taken_ns = rendered(pose)[0], at_ns + stamp_late_ns
            message = bag.image(image, "mono8", taken_ns, "eye")
            if packed:
                data = cv2.imencode(".png", image)[1].tobytes()
                message = bag.compressed(data, "mono8; png compressed", taken_ns, "eye")
            bag.put(topic, message, at_ns + late_ns + eye)
            if infos:
                P = P_RIGHT if eye else None
                info = bag.info(taken_ns, "eye", K, P=P, size=(WIDTH, HEIGHT))
                bag.put(infos[eye], info, at_ns + late_ns + eye)


def calibration(path: Path) -> Path:
    """Of both eyes, as OpenCV's users write it down."""
    eyes = "".join(
        f'"K_{eye}": {K.tolist()}, "D_{eye}": [0, 0, 0, 0, 0], ' for eye in ("left", "right")
    )
    size = f'"width": {WIDTH}, "height": {HEIGHT}, '
    path.write_text(f'{{{size}{eyes}"R": {np.eye(3).tolist()}, "t": [{-BASELINE_M}, 0, 0]}}')
    return path


def s3e(data: Path, walks: Sequence[Sequence[np.ndarray]]) -> tuple[str, Path]:
    """All robots in one bag, without infos; positions once a second, of an antenna."""
    names = ("Alpha", "Bob")
    with Maker(data / "S3E_Room_1") as bag:
        for name, poses in zip(names, walks, strict=True):
            topics = [f"/{name}/{side}_camera/compressed" for side in ("left", "right")]
            stereo(bag, topics, poses, packed=True)
            rows = [
                f"{1e-9 * (BEGIN_NS + k * STEP_NS):.9f} {' '.join(map(str, T[:3, 3]))} 0 0 0 1"
                for k, T in enumerate(poses)
            ]
            (data / f"{name.lower()}_gt.txt").write_text("\n".join(rows) + "\n")
    return ",".join(names), calibration(data / "rig.json")


def kimera_multi(data: Path, walks: Sequence[Sequence[np.ndarray]]) -> tuple[str, None]:
    """A ROS 1 bag for each robot; headers and truth are of another clock than the recorder's."""
    names = ("acl_jackal", "acl_jackal2")
    for name, poses in zip(names, walks, strict=True):
        eyes = [f"/{name}/forward/infra{k}" for k in (1, 2)]
        topics = [f"{eye}/image_rect_raw/compressed" for eye in eyes]
        infos = [f"{eye}/camera_info" for eye in eyes]
        with Maker(data / f"10_14_{name}.bag", ros=1) as bag:
            stereo(bag, topics, poses, packed=True, infos=infos, stamp_late_ns=-LATE_NS)
        rows = [
            f"{BEGIN_NS + k * STEP_NS},{','.join(map(str, T[:3, 3]))},1,0,0,0"
            for k, T in enumerate(poses)
        ]
        (data / "gt").mkdir(exist_ok=True)
        (data / "gt" / f"{name}_gt_odom.csv").write_text(
            "\n".join(("#timestamp_kf,x,y,z,qw,qx,qy,qz", *rows, ""))
        )
    return ",".join(names), None


def graco(data: Path, walks: Sequence[Sequence[np.ndarray]]) -> tuple[str, Path]:
    """A bag for each robot with the same topics, raw images; truth as TUM writes it."""
    names = ("ground-01", "ground-02")
    for name, poses in zip(names, walks, strict=True):
        with Maker(data / name) as bag:
            stereo(bag, ["/camera_left/image_raw", "/camera_right/image_raw"], poses, packed=False)
        stamps_ns = BEGIN_NS + np.arange(len(poses)) * STEP_NS
        write_tum(data / f"{name}.txt", stamps_ns, np.array(poses))
    folder = data / "calibrations"
    folder.mkdir()
    for name in names:
        calibration(folder / f"{name}.json")
    return ",".join(names), folder


BAG_MAKERS = {"s3e": s3e, "kimera-multi": kimera_multi, "graco": graco}
