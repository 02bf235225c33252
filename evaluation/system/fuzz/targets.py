"""The keys that the processes subscribe to: what is good there, who reads it, and what its decoder
says.
"""

import random
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetpose.evaluation.system.fuzz.payloads import IMAGE_KINDS, MESSAGE_KINDS, VIEW_KINDS, Maker
from fleetpose.hmi_client.network.message_decoder import opened, picture_in
from fleetpose.pose_server.state.views import open_view
from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys, new_epoch
from fleetpose.protocol.messages import (
    CameraAnnouncement,
    Odometry,
    OperatorUpdate,
    Receipts,
    Selection,
    ViewName,
)
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.transport import Sample

OPERATOR = "op-fuzz"
STRANGERS = 256
SERVER, CLIENT = ("server",), ("client",)
MAX_TRIES = 60
_OTHERS_KEY = "another's key"


@dataclass(frozen=True)
class Target:
    """One key.

    Attributes:
        readers: the processes that read it: `server`, `client`, or a robot's name.
        good: samples that a reader would take.
        kinds: how to make bad ones, with their shares.
        check: the reader's decoder: raises a FleetPoseError for what it refuses.
        strangers: keys of others, under which a good sample is not theirs.
        share: of all messages.
    """

    readers: tuple[str, ...]
    good: Sample
    kinds: Mapping[str, tuple[Maker, int]]
    check: Callable[[Sample], object]
    strangers: tuple[str, ...] = ()
    share: int = 1

    def refuses(self, sample: Sample) -> bool:
        """Whether the reader's own decoder refuses a sample."""
        try:
            self.check(sample)
        except FleetPoseError:
            return True
        return False

    def bad(self, chance: random.Random, large: bool) -> tuple[str, Sample]:
        """A kind and a sample of it that is surely refused."""
        for _ in range(MAX_TRIES):
            kind, sample = self._tried(chance, large)
            if self.refuses(sample):
                return kind, sample
        raise FleetPoseError(f"nothing that is refused was found for {self.good.key}")

    def _tried(self, chance: random.Random, large: bool) -> tuple[str, Sample]:
        if large:
            kinds = [kind for kind, (_, share) in self.kinds.items() if not share]
            kind = chance.choice(kinds)
        else:
            names = [*self.kinds, _OTHERS_KEY]
            shares = [share for _, share in self.kinds.values()]
            kind = chance.choices(names, [*shares, 2 * bool(self.strangers)])[0]
        if kind == _OTHERS_KEY:
            return kind, replace(self.good, key=chance.choice(self.strangers))
        return kind, self.kinds[kind][0](chance, self.good)


def targets_of(keys: Keys, robots: list[str], heard: Mapping[str, Sample]) -> list[Target]:
    """All keys that anything subscribes to, with samples as they were heard in the running fleet.

    Args:
        keys: of the site.
        robots: that are alive.
        heard: the newest good sample by key.
    """
    server = _Server(keys)
    cloud = heard[keys.cloud(robots[0])]
    clouds = [keys.cloud(f"stranger-{number}") for number in range(STRANGERS)]
    found = [
        Target(SERVER, replace(cloud, key=key), VIEW_KINDS, server.cloud, (clouds[n - 1],), 2)
        for n, key in enumerate(clouds)
    ]
    found += [Target(SERVER, heard[keys.cloud(r)], VIEW_KINDS, server.cloud, (), 2) for r in robots]
    for key, message in _said_by_operators(keys, robots):
        good = Sample(key, pack(message), encoding_of(type(message)))
        selects = isinstance(message, Selection)  # which the other operators' clients read as well
        readers = (*SERVER, *CLIENT) if selects else SERVER
        elsewhere = (keys.selection("op-other") if selects else keys.updates("op-other"),)
        found.append(Target(readers, good, MESSAGE_KINDS, server.operator, elsewhere, 300))
    for robot in robots:
        moment = Odometry(
            robot=robot,
            epoch=new_epoch(),
            stamp_ns=1,
            T_odom_robot=np.eye(4),
            covariance=np.eye(6),
        )
        key, elsewhere = keys.odometry(robot), (keys.odometry("stranger"),)
        good = Sample(key, pack(moment), encoding_of(Odometry))
        found.append(Target(SERVER, good, MESSAGE_KINDS, server.odometry, elsewhere, 60))
    found += _told_to_the_client(keys, robots, heard)
    return found


def _told_to_the_client(
    keys: Keys, robots: list[str], heard: Mapping[str, Sample]
) -> Iterator[Target]:
    """The keys that the operator's client reads; poses are read by every robot as well."""

    def check(sample: Sample) -> object:
        return opened(keys, sample)

    def told(good: Sample, *strangers: str, robots: Sequence[str] = (), share: int = 100) -> Target:
        return Target((*CLIENT, *robots), good, MESSAGE_KINDS, check, strangers, share)

    a, b, *_ = robots
    yield told(heard[keys.state], keys.status)
    yield told(heard[keys.status], keys.state)
    for robot in robots:
        yield told(
            heard[keys.pose(robot)],
            *(keys.pose(other) for other in ("stranger", *robots) if other != robot),
            robots=robots,
            share=60,
        )
        # which the server reads as well
        yield told(heard[keys.camera(robot)], keys.camera("stranger"), robots=SERVER, share=60)
    pair = next(key for key in heard if key.endswith("/alignment"))
    yield told(heard[pair], keys.alignment("r-a", "r-b"))
    sets = next(key for key in heard if "/pair/" in key and key.endswith("/correspondences"))
    yield told(heard[sets], keys.correspondences("r-a", "r-b"))
    receipts = Receipts(
        operator=OPERATOR, session=new_epoch(), n=1, rejections=(), server_epoch=new_epoch()
    )
    key = keys.receipts(OPERATOR)
    yield told(Sample(key, pack(receipts), encoding_of(Receipts)))
    for robot in (a, b):
        image = heard[keys.image(robot)]
        announced = unpack(CameraAnnouncement, heard[keys.camera(robot)].payload)

        def picture(
            sample: Sample, robot: str = robot, announced: CameraAnnouncement = announced
        ) -> object:
            return picture_in(sample, robot, announced, time.monotonic())

        yield Target(CLIENT, image, IMAGE_KINDS, picture, (), 100)


class _Server:
    """The server's decoders, as its shell calls them."""

    def __init__(self, keys: Keys) -> None:
        self._keys = keys

    def cloud(self, sample: Sample) -> object:
        view = open_view(sample.payload, sample.encoding, time.monotonic())
        return self._owned(sample, 1, view.name.robot)

    def operator(self, sample: Sample) -> object:
        kind = Selection if sample.key.endswith("/selection") else OperatorUpdate
        return self._owned(sample, 1, unpack(kind, sample.payload, sample.encoding).operator)

    def odometry(self, sample: Sample) -> object:
        return self._owned(sample, 1, unpack(Odometry, sample.payload, sample.encoding).robot)

    def _owned(self, sample: Sample, place: int, name: str) -> object:
        if self._keys.chunks(sample.key)[place] != name:
            raise CodecError("under another's key")
        return name


def _said_by_operators(keys: Keys, robots: list[str]) -> Iterator[tuple[str, Message]]:
    a, b, *_ = sorted(robots)
    views = {
        side: ViewName(robot=robot, epoch=new_epoch(), seq=3)
        for side, robot in (("view_i", a), ("view_j", b))
    }
    pixels = {"pixel_i": [10.0, 20.0], "pixel_j": [30.0, 40.0]}
    who = {"operator": OPERATOR, "session": new_epoch(), "i": a, "j": b}
    update = {**who, "n": 1, "action": "add", "base_revision": 0, **views, **pixels}
    yield keys.updates(OPERATOR), OperatorUpdate.model_validate(update)
    yield keys.selection(OPERATOR), Selection.model_validate({**who, **views})
