"""Bags for tests, written by rosbags: robots with depth cameras and stereo rigs.

The scene is a textured wall with a step in it; each frame is another one. Stamps of the drivers are
in 2023, the recorder is some milliseconds later.
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SIZE = WIDTH, HEIGHT = 96, 72
K = np.array([[80.0, 0, 47.5], [0, 80.0, 35.5], [0, 0, 1]])
BEGIN_NS = 1_700_000_000 * 10**9
PERIOD_NS = 100_000_000
DEPTH_SKEW_NS = 6_000_000
T_BASE_LINK = np.eye(4)
T_BASE_LINK[:3, 3] = (0.2, 0.03, 0.9)
T_LINK_OPTICAL = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
QUANT_A, QUANT_B = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0  # image_transport's defaults, 10 m
ZSTD_MESSAGES = (CompressionMode.MESSAGE, CompressionFormat.ZSTD)
ZSTD_STORAGE = (CompressionMode.STORAGE, CompressionFormat.ZSTD)


@dataclass
class Source:
    """What the cameras saw: colours (H, W, 3) BGR and depths (H, W) uint16 mm by frame."""

    colours: list = field(default_factory=list)
    depths: list = field(default_factory=list)


def source(frames=5, seed=0):
    rng = np.random.default_rng(seed)
    made = Source()
    for k in range(frames):
        noise = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
        made.colours.append(cv2.GaussianBlur(noise, (0, 0), 1.0))
        depth = np.full((HEIGHT, WIDTH), 1500 + 10 * k, np.uint16)
        step = 40 + k % 20
        depth[:, step:] = rng.integers(1800, 4000, (HEIGHT, WIDTH - step), np.uint16)
        depth[:5], depth[-1] = 0, 65535
        made.depths.append(depth)
    return made


class Maker:
    """Writes one bag.

    Args:
        path: folder of a rosbag2, or file of a ROS 1 bag.
        ros: 1 or 2.
        options: `plugin` and `compression` of a rosbag2.
    """

    def __init__(self, path, ros=2, plugin=StoragePlugin.MCAP, compression=None):
        self.path, self.ros = Path(path), ros
        self.store = get_typestore(Stores.ROS2_HUMBLE if ros == 2 else Stores.ROS1_NOETIC)
        if ros == 1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.writer = (
            Writer1(self.path) if ros == 1 else Writer2(self.path, version=9, storage_plugin=plugin)
        )
        if compression is not None:
            self.writer.set_compression(*compression)
        self.writer.open()
        self._connections = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.writer.close()

    def of(self, of_type, /, **fields):
        """A message of a type, `sensor_msgs/Image`."""
        package, _, kind = of_type.partition("/")
        return self.store.types[f"{package}/msg/{kind}"](**fields)

    def put(self, topic, message, at_ns):
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        coded = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        self.writer.write(self._connections[topic], at_ns, coded(message, kind))

    def header(self, stamp_ns, frame):
        seconds, rest = divmod(int(stamp_ns), 10**9)
        stamp = self.of("builtin_interfaces/Time", sec=seconds, nanosec=rest)
        more = {"seq": 0} if self.ros == 1 else {}
        return self.of("std_msgs/Header", stamp=stamp, frame_id=frame, **more)

    def image(self, array, encoding, stamp_ns, frame, padding=0, big=False):
        """An Image whose rows are longer than they need to be by some bytes."""
        array = np.ascontiguousarray(array)
        if big:
            array = array.byteswap()
        rows = array.view(np.uint8).reshape(array.shape[0], -1)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=171)
        return self.of(
            "sensor_msgs/Image",
            header=self.header(stamp_ns, frame),
            height=array.shape[0],
            width=array.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.reshape(-1),
        )

    def compressed(self, data, form, stamp_ns, frame):
        return self.of(
            "sensor_msgs/CompressedImage",
            header=self.header(stamp_ns, frame),
            format=form,
            data=np.frombuffer(data, np.uint8),
        )

    def info(self, stamp_ns, frame, K=K, D=None, R=None, P=None, size=SIZE, model="plumb_bob"):
        P = np.hstack((K, np.zeros((3, 1)))) if P is None else P
        numbers = {
            "d": np.zeros(5) if D is None else np.asarray(D, float).reshape(-1),
            "k": K.reshape(-1),
            "r": (np.eye(3) if R is None else R).reshape(-1),
            "p": P.reshape(-1),
        }
        if self.ros == 1:
            numbers = {name.upper(): value for name, value in numbers.items()}
        roi = self.of(
            "sensor_msgs/RegionOfInterest",
            **dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0),
            do_rectify=False,
        )
        return self.of(
            "sensor_msgs/CameraInfo",
            header=self.header(stamp_ns, frame),
            height=size[1],
            width=size[0],
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **numbers,
        )

    def transforms(self, stamp_ns, *edges):
        """Of (parent, child, T) each."""
        return self.of("tf2_msgs/TFMessage", transforms=[self._edge(stamp_ns, *e) for e in edges])

    def _edge(self, stamp_ns, parent, child, T):
        t = self.of("geometry_msgs/Vector3", **dict(zip("xyz", map(float, T[:3, 3]), strict=True)))
        return self.of(
            "geometry_msgs/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=self.of(
                "geometry_msgs/Transform", translation=t, rotation=self._quaternion(T)
            ),
        )

    def _quaternion(self, T):
        from scipy.spatial.transform import Rotation

        q = Rotation.from_matrix(T[:3, :3]).as_quat()
        return self.of("geometry_msgs/Quaternion", **dict(zip("xyzw", map(float, q), strict=True)))

    def odometry(self, stamp_ns, T, covariance=None, frame="odom", child="base_link"):
        position = self.of(
            "geometry_msgs/Point", **dict(zip("xyz", map(float, T[:3, 3]), strict=True))
        )
        pose = self.of("geometry_msgs/Pose", position=position, orientation=self._quaternion(T))
        numbers = np.zeros(36) if covariance is None else np.asarray(covariance).reshape(-1)
        zero = self.of("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0)
        return self.of(
            "nav_msgs/Odometry",
            header=self.header(stamp_ns, frame),
            child_frame_id=child,
            pose=self.of("geometry_msgs/PoseWithCovariance", pose=pose, covariance=numbers),
            twist=self.of(
                "geometry_msgs/TwistWithCovariance",
                twist=self.of("geometry_msgs/Twist", linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )

    def imu(self, acceleration, stamp_ns, frame, turning=(0, 0, 0)):
        felt, turned = (
            self.of("geometry_msgs/Vector3", **dict(zip("xyz", map(float, one), strict=True)))
            for one in (acceleration, turning)
        )
        return self.of(
            "sensor_msgs/Imu",
            header=self.header(stamp_ns, frame),
            orientation=self.of("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.array([-1.0, *[0.0] * 8]),
            angular_velocity=turned,
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=felt,
            linear_acceleration_covariance=np.zeros(9),
        )

    def cloud(self, xyz, stamp_ns, frame):
        """PointCloud2 of (H, W, 3): x y z and four bytes more."""
        height, width, _ = xyz.shape
        data = np.zeros((height, width, 4), np.float32)
        data[..., :3] = xyz
        fields = [
            self.of("sensor_msgs/PointField", name=name, offset=4 * k, datatype=7, count=1)
            for k, name in enumerate("xyz")
        ]
        return self.of(
            "sensor_msgs/PointCloud2",
            header=self.header(stamp_ns, frame),
            height=height,
            width=width,
            fields=fields,
            is_bigendian=False,
            point_step=16,
            row_step=16 * width,
            data=data.view(np.uint8).reshape(-1),
            is_dense=False,
        )


def T_odom_base(k):
    """Where the robot is when it takes frame k."""
    T = np.eye(4)
    angle = 0.02 * k
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[0, 3] = 0.05 * k
    return T


def compressed_depth(raw, kind, header=(0, 0.0, 0.0)):
    body = rvl(raw) if kind == "rvl" else cv2.imencode(".png", raw)[1].tobytes()
    return struct.pack("<iff", *header) + body


def inverse_quantised(depth_mm):
    """As compressed_depth_image_transport codes depths in metres."""
    with np.errstate(divide="ignore"):
        inverse = QUANT_A / (depth_mm / 1000.0) + QUANT_B
    none = (depth_mm == 0) | (depth_mm == 65535)
    return np.where(none, 0, inverse).astype(np.uint16)


def rvl(raw):
    """Width, height and the code of the paper's listing, nibble by nibble."""
    nibbles = []

    def number(value):
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    pixels, k, before = raw.reshape(-1).astype(int).tolist(), 0, 0
    while k < len(pixels):
        begin = k
        while k < len(pixels) and not pixels[k]:
            k += 1
        number(k - begin)
        begin = k
        while k < len(pixels) and pixels[k]:
            k += 1
        number(k - begin)
        for value in pixels[begin:k]:
            delta = value - before
            number((delta << 1) ^ (delta >> 31))
            before = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        sum(nibble << (28 - 4 * n) for n, nibble in enumerate(nibbles[w : w + 8]))
        for w in range(0, len(nibbles), 8)
    ]
    size = struct.pack("<II", raw.shape[1], raw.shape[0])
    return size + np.array(words, "<u4").tobytes()


def write_rgbd(path, made, colour="rgb8", depth="16UC1", ns="/r1", static_tf=True, **options):
    """Colour and depth of a robot with tf and odometry; infos come after the first image."""
    base = f"{ns}/camera/aligned_depth_to_color/image_raw"
    frame = "camera_color_optical_frame"
    with Maker(path, **options) as bag:
        for k, (bgr, mm) in enumerate(zip(made.colours, made.depths, strict=True)):
            at_ns = BEGIN_NS + k * PERIOD_NS
            got_ns = at_ns + 20_000_000
            _put_colour(bag, f"{ns}/camera/color/image_raw", bgr, colour, at_ns, frame, got_ns)
            _put_depth(bag, base, mm, depth, at_ns + DEPTH_SKEW_NS, frame, got_ns + 1)
            bag.put(f"{ns}/camera/color/camera_info", bag.info(at_ns, frame), got_ns + 2)
            T = T_odom_base(k)
            bag.put(f"{ns}/odom", bag.odometry(at_ns, T, np.eye(6) * 1e-4), got_ns + 3)
            if static_tf and not k:
                edges = (
                    ("base_link", "camera_link", T_BASE_LINK),
                    ("camera_link", frame, T_LINK_OPTICAL),
                )
                bag.put("/tf_static", bag.transforms(at_ns, *edges), got_ns + 4)
    return path


def _put_colour(bag, topic, bgr, coding, at_ns, frame, got_ns):
    if coding == "jpeg":
        data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        message = bag.compressed(data, "rgb8; jpeg compressed bgr8", at_ns, frame)
        return bag.put(f"{topic}/compressed", message, got_ns)
    array = bgr[..., ::-1] if coding == "rgb8" else bgr
    return bag.put(topic, bag.image(array, coding, at_ns, frame, padding=8), got_ns)


def _put_depth(bag, topic, mm, coding, at_ns, frame, got_ns):
    if coding == "16UC1":
        return bag.put(topic, bag.image(mm, coding, at_ns, frame, padding=6), got_ns)
    if coding == "32FC1":
        metres = np.where((mm == 0) | (mm == 65535), np.nan, mm / 1000).astype(np.float32)
        return bag.put(topic, bag.image(metres, coding, at_ns, frame), got_ns)
    kind = coding.removeprefix("compressed ")
    form = f"16UC1; compressedDepth {kind}"
    data = compressed_depth(mm, kind)
    if kind == "inverse":
        form = "32FC1; compressedDepth png"
        data = compressed_depth(inverse_quantised(mm), "png", (0, QUANT_A, QUANT_B))
    return bag.put(f"{topic}/compressedDepth", bag.compressed(data, form, at_ns, frame), got_ns)
