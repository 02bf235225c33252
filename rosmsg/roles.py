"""Which topic is what: colour, depth, left, right, cloud, infos, odometry, by type and name."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from fleetpose.protocol.errors import DataFolderError
from fleetpose.rosmsg.bag import Topic

CameraForm = Literal["rgbd", "stereo", "cloud"]

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"
CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
IMU = "sensor_msgs/msg/Imu"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
HEADED = (*IMAGES, INFO, CLOUD, ODOMETRY, IMU)
"""Types whose messages begin with a header."""

_TRANSPORTS = ("/compressedDepth", "/compressed")
_EYES = (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("infrared1", "infrared2"))
_TRUTH = re.compile(r"(^|[/_])(gt|truth|ground_?truth|groundtruth)([/_]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class Wanted:
    """What the user names instead of leaving it to be found; empty: found."""

    image: str = ""
    depth: str = ""
    left: str = ""
    right: str = ""
    cloud: str = ""


@dataclass(frozen=True)
class Roles:
    """Which topic is what; None where there is none.

    Attributes:
        form: what kind of camera they make.
        image: colours, or the left eye of two.
        ranges: depths, the right eye, or the cloud.
        infos: the CameraInfo of both, in that order.
        odometry, imu, tf: what tells of its motion, and of where the camera sits.
        why: of each role, why that topic.
    """

    form: CameraForm
    image: str
    ranges: str
    infos: tuple[str | None, str | None]
    odometry: str | None = None
    imu: str | None = None
    tf: tuple[str, ...] = ()
    why: dict[str, str] = field(default_factory=dict)

    @property
    def names(self) -> dict[str, str | None]:
        """Topics by the names of their roles."""
        image, ranges = {
            "rgbd": ("colour", "depth"),
            "stereo": ("left", "right"),
            "cloud": ("colour", "cloud"),
        }[self.form]
        return {
            image: self.image,
            ranges: self.ranges,
            f"{image} info": self.infos[0],
            **({f"{ranges} info": self.infos[1]} if self.form != "cloud" else {}),
            "odometry": self.odometry,
            "imu": self.imu,
        }


def choose(
    topics: Sequence[Topic],
    namespace: str = "",
    wanted: Wanted | None = None,
    frame_of: Callable[[str], str] = lambda topic: "",
) -> Roles:
    """The camera of a robot among the topics of its bag: colour and depth if there are both, else
    two eyes, else colour and a cloud.

    Args:
        topics: those without messages count for nothing.
        namespace: only topics below it; those of tf may be global.
        wanted: topics that the user names.
        frame_of: the frame of a topic's images: depths are best in the frame of their image.

    Raises:
        DataFolderError: there is no camera, or a topic that is named is not there.
    """
    wanted = wanted or Wanted()
    found = _Topics(topics, namespace, frame_of)
    for name in vars(wanted).values():
        found.check(name)
    form = _form_of(found, wanted)
    if form is None:
        raise DataFolderError(found.why_no_camera())
    roles = {"rgbd": _rgbd, "stereo": _stereo, "cloud": _cloud}[form](found, wanted)
    return _with_motion(found, roles)


def base_of(topic: str) -> str:
    """A topic's name without how its images are packed."""
    for transport in _TRANSPORTS:
        topic = topic.removesuffix(transport)
    return topic


def is_rectified(topic: str) -> bool:
    """Whether images of a topic are rectified, as image_proc names them."""
    return "rect" in base_of(topic).rpartition("/")[2]


def is_below(topic: str, namespace: str) -> bool:
    """Whether a topic is in a namespace; all are in that without a name."""
    slashed = f"/{namespace.strip('/')}"
    return slashed == "/" or f"/{topic.lstrip('/')}/".startswith(f"{slashed}/")


def is_depth(topic: str) -> bool:
    """Whether an image topic is one of depths, by its name."""
    return "depth" in topic.lower()


def eye_of(topic: str) -> tuple[str, str] | None:
    """The left topic's partner: the names of both eyes in a left one's name."""
    for left, right in _EYES:
        if re.search(rf"(^|[/_]){left}([/_\d]|$)", topic):
            return left, right
    return None


def _is_eye(topic: str) -> bool:
    return any(re.search(rf"(^|[/_]){eye}([/_\d]|$)", topic) for eyes in _EYES for eye in eyes)


class _Topics:
    """Topics below a namespace, by what they can be."""

    def __init__(
        self, topics: Sequence[Topic], namespace: str, frame_of: Callable[[str], str]
    ) -> None:
        self.namespace = namespace.rstrip("/")
        self.frame_of = frame_of
        self._all = [topic for topic in topics if topic.count]
        below = [t for t in self._all if is_below(t.name, self.namespace)]
        self._of_robot = {topic.name: topic for topic in below}
        images = [topic.name for topic in below if topic.type in IMAGES]
        self.depths = [name for name in images if is_depth(name)]
        self.colours = [name for name in images if not is_depth(name)]
        self.lefts = [name for name in self.colours if self.right_of(name) is not None]
        self.clouds = self.of_type(CLOUD)
        self.infos = self.of_type(INFO)

    def of_type(self, *types: str) -> list[str]:
        return [name for name, topic in self._of_robot.items() if topic.type in types]

    def tf(self) -> tuple[str, ...]:
        """Of the robot where it has its own, else of all."""
        own = tuple(self.of_type(*TF))
        return own or tuple(topic.name for topic in self._all if topic.type in TF)

    def right_of(self, left: str) -> str | None:
        eyes = eye_of(left)
        if eyes is None:
            return None
        right = left.replace(*eyes)
        return right if right in self._of_robot else None

    def check(self, name: str) -> None:
        if name and name not in self._of_robot:
            known = ", ".join(self._of_robot) or "none"
            raise DataFolderError(f"there are no messages of '{name}'; topics are: {known}")

    def info_of(self, topic: str) -> str | None:
        """The CameraInfo beside a topic, else the only one in its frame."""
        beside = f"{base_of(topic).rpartition('/')[0]}/camera_info"
        if beside in self.infos:
            return beside
        frame = self.frame_of(topic)
        same = [info for info in self.infos if frame and self.frame_of(info) == frame]
        return same[0] if len(same) == 1 else None

    def why_no_camera(self) -> str:
        below = f" below '{self.namespace}'" if self.namespace else ""
        lacks = "no images" if not (self.colours or self.depths) else "images, but no depths"
        return (
            f"no camera among the topics{below}: {lacks}. It needs colours and depths, two eyes, "
            f"or colours and a cloud; name them with --image, --depth, --left, --right, --cloud "
            f"(robot-agent topics lists all)"
        )


def _form_of(found: _Topics, wanted: Wanted) -> CameraForm | None:
    if wanted.left or wanted.right:
        return "stereo"
    if wanted.cloud:
        return "cloud"
    colours = wanted.image or found.colours
    if wanted.depth or (found.depths and colours):
        return "rgbd"
    if found.lefts:
        return "stereo"
    return "cloud" if found.clouds and colours else None


def _rank(topic: str) -> tuple[bool, bool, str]:
    """Rectified before raw, unpacked before packed."""
    return not is_rectified(topic), topic != base_of(topic), topic


def _rgbd(found: _Topics, wanted: Wanted) -> Roles:
    colours = [wanted.image] if wanted.image else found.colours or found.depths
    depths = [wanted.depth] if wanted.depth else found.depths

    def cost(pair: tuple[str, str]) -> tuple[object, ...]:
        colour, depth = pair
        apart = _frames_differ(found, colour, depth)
        registered = any(word in depth for word in ("aligned", "registered"))
        elsewhere = _top(colour) != _top(depth)  # of another robot, where names say so
        an_eye = _is_eye(colour)
        return elsewhere, apart, not registered, an_eye, _rank(depth), _rank(colour)

    pairs = [(colour, depth) for colour in colours for depth in depths if colour != depth]
    if not pairs:
        raise DataFolderError(found.why_no_camera())
    colour, depth = min(pairs, key=cost)
    why_depth = "named" if wanted.depth else "an image with 'depth' in its name"
    if _frames_differ(found, colour, depth):
        why_depth += f", not in the frame of {colour}: its points are projected into that"
    elif found.frame_of(depth):
        why_depth += f", in the frame of {colour}"
    why_colour = "named" if wanted.image else "an image without 'depth' in its name"
    return Roles(
        "rgbd",
        colour,
        depth,
        (found.info_of(colour), found.info_of(depth)),
        why={"colour": why_colour, "depth": why_depth},
    )


def _top(topic: str) -> str:
    return topic.strip("/").partition("/")[0]


def _frames_differ(found: _Topics, a: str, b: str) -> bool:
    return bool(found.frame_of(a) and found.frame_of(b) and found.frame_of(a) != found.frame_of(b))


def _stereo(found: _Topics, wanted: Wanted) -> Roles:
    left = wanted.left or min(found.lefts, key=_rank, default="")
    right = wanted.right or found.right_of(left)
    if not left or not right:
        raise DataFolderError(f"'{left or right}' has no partner: give both, --left and --right")
    by = "named" if wanted.left or wanted.right else "names differ in left and right alone"
    return Roles(
        "stereo",
        left,
        right,
        (found.info_of(left), found.info_of(right)),
        why={"left": by, "right": by},
    )


def _cloud(found: _Topics, wanted: Wanted) -> Roles:
    image = wanted.image or min(found.colours, key=_rank, default="")
    cloud = wanted.cloud or found.clouds[0]
    if not image:
        raise DataFolderError(f"'{cloud}' has no image beside it: give --image")
    why_cloud = "named" if wanted.cloud else "a cloud, and there are no depth images"
    why = {"colour": "named" if wanted.image else "an image", "cloud": why_cloud}
    return Roles("cloud", image, cloud, (found.info_of(image), None), why=why)


def _with_motion(found: _Topics, roles: Roles) -> Roles:
    odometries = [name for name in found.of_type(ODOMETRY) if not _TRUTH.search(name)]
    odometry = min(odometries, key=lambda name: ("odom" not in name, len(name)), default=None)
    imu = next(iter(found.of_type(IMU)), None)
    why = dict(roles.why)
    for of, info in zip(roles.names, roles.infos, strict=False):
        if info is not None:
            why[f"{of} info"] = f"of {of}, by its folder or frame"
    if odometry is not None:
        others = len(odometries) - 1
        why["odometry"] = "by its type" + (f", of {others + 1} the plainest name" if others else "")
    if imu is not None:
        why["imu"] = "by its type; not used yet"
    return replace(roles, odometry=odometry, imu=imu, tf=found.tf(), why=why)


def missing(roles: Roles, calibrated: bool = False) -> Iterator[str]:
    """What a camera lacks, and what to do, in sentences.

    Args:
        calibrated: whether a calibration is given beside the bag.
    """
    needed = roles.infos if roles.form == "stereo" else roles.infos[:1]
    if not calibrated and any(info is None for info in needed):
        yield "no CameraInfo of its images: give --calibration FILE"
    if roles.odometry is None:
        yield "no odometry: motion between views is found by images alone"
