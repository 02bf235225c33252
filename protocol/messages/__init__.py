"""Everything that is said on the wire, one class each.

Metres, radians, UTC nanoseconds of the sender's clock; camera frames have OpenCV axes (x right, y
down, z forward); pixel (0, 0) is the centre of the top-left pixel of the rectified full-resolution
image. `T_a_b` maps points of frame b to frame a. Covariances are ordered rotation then translation
and belong to left perturbations, `exp(xi) T_a_b`.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from fleetpose.protocol.messages.alignment import Alignment as Alignment
from fleetpose.protocol.messages.alignment import IcpFit as IcpFit
from fleetpose.protocol.messages.alignment import OperatorFit as OperatorFit
from fleetpose.protocol.messages.arrays import ClickedPixel, Matrix6, Pixel, Pose, Vector3
from fleetpose.protocol.messages.base import MAX_MESSAGE_BYTES, Message
from fleetpose.protocol.messages.camera import ROBOT_FROM_CAMERA as ROBOT_FROM_CAMERA
from fleetpose.protocol.messages.camera import Camera
from fleetpose.protocol.messages.camera import NoiseModel as NoiseModel
from fleetpose.protocol.messages.fields import (
    Clock,
    Count,
    Epoch,
    Many,
    Moment,
    Name,
    NonNegative,
    Positive,
    Probability,
    Stamp,
    Text,
)
from fleetpose.protocol.messages.fields import Verdict as Verdict
from fleetpose.protocol.messages.network import Denial as Denial
from fleetpose.protocol.messages.network import Denials as Denials
from fleetpose.protocol.messages.network import Heard as Heard
from fleetpose.protocol.messages.questions import Answer as Answer
from fleetpose.protocol.messages.questions import Question as Question
from fleetpose.protocol.messages.questions import Suggestion as Suggestion
from fleetpose.protocol.messages.replies import RelativePose as RelativePose
from fleetpose.protocol.messages.replies import WhyNot as WhyNot
from fleetpose.protocol.messages.view_name import ViewName as ViewName


class CameraAnnouncement(
    Message,
    frozen=True,
    schema="fleet.camera_announcement.v3",
    before="fleet.camera_announcement.v2",
):
    """What is latched under `robot/<id>/camera`. v3 says whose time its stamps are of."""

    robot: Name
    epoch: Epoch
    camera: Camera
    rate_hz: Positive
    capabilities: Many[Name] = ()
    version: Text = Field(default="", description="of the robot's software")
    clock: Clock = Field(
        default="live",
        description="whose time stamps are of: the robot's clock now (live), or that of a "
        "recording (recorded), whose views come long after they were taken",
    )


class DepthCloud(Message, frozen=True, schema="fleet.depth_cloud.v1", at_most=MAX_MESSAGE_BYTES):
    """An organised cloud: a depth or disparity image, lossless to `step`."""

    form: Literal["depth"] = "depth"
    width: Annotated[int, Field(gt=0, le=16384)]
    height: Annotated[int, Field(gt=0, le=16384)]
    scale: Annotated[int, Field(ge=1, le=16)] = Field(
        default=1, description="full-resolution pixels per cloud pixel"
    )
    coding: Literal["depth", "disparity"]
    step: Positive = Field(description="quantum: metres of depth, px of disparity")
    focal_baseline_px_m: Positive | None = Field(
        default=None, description="z = focal_baseline / disparity; only for disparity"
    )
    data: bytes

    @model_validator(mode="after")
    def _coding(self) -> "DepthCloud":
        if (self.coding == "disparity") != (self.focal_baseline_px_m is not None):
            raise ValueError("focal_baseline_px_m goes with coding 'disparity', and only with it")
        return self


class ScatteredCloud(
    Message, frozen=True, schema="fleet.scattered_cloud.v1", at_most=MAX_MESSAGE_BYTES
):
    """Points with their pixels, for clouds without a grid. Coded in `protocol.clouds`."""

    form: Literal["scattered"] = "scattered"
    count: Annotated[int, Field(ge=0, le=2_000_000)]
    pixel_step_px: Positive = Field(description="quantum of the pixels")
    depth_step_m: Positive = Field(description="quantum of z")
    data: bytes


class Salient(Message, frozen=True, schema="fleet.salient.v1", at_most=MAX_MESSAGE_BYTES):
    """Salient points of a view with descriptors, strongest first. Coded in `protocol.clouds`."""

    extractor: Name = Field(description="which detector and descriptor, e.g. rootsift")
    count: Annotated[int, Field(ge=0, le=100_000)]
    descriptor_bytes: Annotated[int, Field(ge=1, le=1024)]
    data: bytes


class View(
    Message,
    frozen=True,
    schema="fleet.view.v3",
    before="fleet.view.v2",
    at_most=MAX_MESSAGE_BYTES,
):
    """`robot/<id>/cloud`: what a robot saw at one moment, without the image. v3 says what the link
    makes of it.
    """

    name: ViewName
    stamp_ns: Stamp
    camera: Camera
    cloud: Annotated[DepthCloud | ScatteredCloud, Field(discriminator="form")]
    salient: Salient
    up_camera: Vector3 | None = Field(default=None, description="unit vector against gravity")
    up_sigma_rad: Positive | None = None
    has_image: bool = True
    frozen_s: NonNegative = Field(
        default=0.0,
        description="for how long all images of a live camera have been identical to the last bit, "
        "which no sensor's are, s; 0 where they are not, or where the source is a recording",
    )
    on_way_s: NonNegative = Field(
        default=0.0, description="that the view before it took to the server; 0 where not known"
    )
    share: Probability = Field(
        default=1.0, description="of the salient points that it sends where the link is fast"
    )

    @model_validator(mode="after")
    def _unit_up(self) -> "View":
        up = self.up_camera
        if up is not None and (np.abs(up).max() > 1.01 or abs(np.linalg.norm(up) - 1) > 0.01):
            raise ValueError("up_camera is no unit vector")
        return self


class ImageHeader(Message, frozen=True, schema="fleet.image_header.v1"):
    """Travels as the attachment of a JPEG under `robot/<id>/image`."""

    view: ViewName
    stamp_ns: Stamp
    scale: Annotated[int, Field(ge=1, le=16)] = Field(
        default=1, description="full-resolution pixels per image pixel"
    )


class KeptView(
    Message,
    frozen=True,
    schema="fleet.kept_view.v3",
    before="fleet.kept_view.v2",
    at_most=MAX_MESSAGE_BYTES,
):
    """Reply of `robot/<id>/view?seq=12` : a view kept by its robot, or journalled by the server. v3
    holds a `View` of v3.
    """

    view: View
    jpeg: bytes | None = None
    image: ImageHeader | None = None


class Odometry(Message, frozen=True, schema="fleet.odometry.v1"):
    """`robot/<id>/odometry`: absolute in the robot's own odometry frame."""

    robot: Name
    epoch: Epoch
    stamp_ns: Stamp
    T_odom_robot: Pose
    covariance: Matrix6


class PairError(Message, frozen=True, schema="fleet.pair_error.v2", before="fleet.pair_error.v1"):
    """One of a robot's pairs, as its pose message tells it: its last alignment, not its best. v2
    has no error where that failed.
    """

    other: Name
    rmse_m: NonNegative | None = Field(description="none where the last alignment failed")
    verdict: Verdict


class RobotPose(Message, frozen=True, schema="fleet.pose.v2", before="fleet.pose.v1"):
    """`pose/<id>`: where a robot is in the fleet frame. v2 says why it is not located."""

    robot: Name
    view: ViewName = Field(description="the view whose moment this pose is of")
    stamp_ns: Stamp = Field(description="of that view, robot's clock")
    T_fleet_robot: Pose
    covariance: Matrix6 = Field(description="left perturbation of T_fleet_robot, rotation first")
    component: Name = Field(
        description="the anchor of its component: poses compare only within one"
    )
    located: bool = Field(description="joined to the fleet's anchor, fresh, and sure enough")
    verdict: Verdict = Field(description="of its weakest link to the component's anchor")
    gauge_revision: Count
    jumped: bool = Field(
        description="moved by more than its own motion and sigma since the last one"
    )
    age_s: NonNegative = Field(description="of the view, by the server's clock, when sent")
    valid_until_ns: Moment = Field(description="robot's clock; afterwards the pose is stale")
    errors: Many[PairError] = ()
    server_epoch: Epoch
    n: Count = Field(description="counts up per robot and server epoch")
    why_not: Text = Field(
        default="", description="why it is not located, as operators read it; empty if it is"
    )

    @property
    def valid_for_s(self) -> float:
        """For how long it may be acted on from when it was sent; by the receiver's own clock that
        is from its arrival. Zero: it was too old when sent.
        """
        return max((self.valid_until_ns - self.stamp_ns) * 1e-9 - self.age_s, 0.0)


CorrespondenceStatus = Literal["accepted", "outlier", "unused"]


class Correspondence(Message, frozen=True, schema="fleet.correspondence.v1"):
    """One point clicked in two images."""

    id: Count
    operator: Name
    view_i: ViewName
    view_j: ViewName
    pixel_i: Pixel
    pixel_j: Pixel
    status: CorrespondenceStatus = "unused"
    residual_m: NonNegative | None = Field(default=None, description="|p_i - T_i_j p_j|")
    residual_px: NonNegative | None = Field(default=None, description="in image i")
    revision: Count = 0


class PairCorrespondences(Message, frozen=True, schema="fleet.pair_correspondences.v1"):
    """`pair/<i>/<j>/correspondences`: the authoritative set of a pair, i < j."""

    i: Name
    j: Name
    revision: Count
    items: Many[Correspondence]
    server_epoch: Epoch


class OperatorUpdate(Message, frozen=True, schema="fleet.operator_update.v1"):
    """`operator/<op>/correspondences`: one numbered change, repeated until a receipt covers it."""

    operator: Name
    session: Epoch = Field(description="one life of the operator's client")
    n: Annotated[int, Field(ge=1, lt=2**63)] = Field(description="1, 2, 3, ... within the session")
    action: Literal["add", "move", "erase", "clear"]
    i: Name
    j: Name
    base_revision: Count = Field(description="revision of the correspondence (or set) acted on")
    correspondence: Count | None = Field(default=None, description="id, for move and erase")
    view_i: ViewName | None = None
    view_j: ViewName | None = None
    pixel_i: ClickedPixel | None = None
    pixel_j: ClickedPixel | None = None

    @model_validator(mode="after")
    def _complete(self) -> "OperatorUpdate":
        places = (self.view_i, self.view_j, self.pixel_i, self.pixel_j)
        if self.action in ("add", "move") and any(place is None for place in places):
            raise ValueError(f"'{self.action}' needs both views and both pixels")
        if self.action in ("move", "erase") and self.correspondence is None:
            raise ValueError(f"'{self.action}' needs the id of a correspondence")
        return self


class Rejection(Message, frozen=True, schema="fleet.rejection.v1"):
    """Why an update was not accepted; final like an acceptance."""

    n: Count
    reason: Text


class Receipts(Message, frozen=True, schema="fleet.receipts.v1"):
    """`operator/<op>/receipts`: all updates of the session up to n are final and in the journal."""

    operator: Name
    session: Epoch
    n: Count
    rejections: Many[Rejection] = Field(description="the newest 100")
    server_epoch: Epoch


class Selection(Message, frozen=True, schema="fleet.selection.v1"):
    """`operator/<op>/selection`: the pair on the operator's screen; its frozen views are kept."""

    operator: Name
    session: Epoch
    i: Name | None
    j: Name | None
    view_i: ViewName | None = None
    view_j: ViewName | None = None


class PairCell(Message, frozen=True, schema="fleet.pair_cell.v2", before="fleet.pair_cell.v1"):
    """One cell of the error matrix, i < j: the last alignment of the pair, whatever came of it. v2
    tells how likely that is gravely off.
    """

    i: Name
    j: Name
    state: Literal["untried", "through_others", "tried"]
    verdict: Verdict | None = None
    rmse_m: NonNegative | None = Field(default=None, description="none where it was rejected")
    regression_error_m2: NonNegative | None = None
    regression_count: Count = 0
    overlap: NonNegative = 0.0
    age_s: NonNegative = Field(default=0.0, description="since that alignment")
    correspondences: Count = 0
    p_grave: Probability | None = Field(
        default=None, description="that its pose is gravely off; none without a pose"
    )
    rivals: Count = Field(default=0, description="other poses that the images support as well")


class RobotState(
    Message, frozen=True, schema="fleet.robot_state.v2", before="fleet.robot_state.v1"
):
    """One robot in the fleet's state. v2 holds a pose of v2."""

    robot: Name
    alive: bool
    newest_view: ViewName | None
    views_kept: Count
    pose: RobotPose | None
    why_not: Text = Field(description="why it is not located; empty if it is")


class Alarm(Message, frozen=True, schema="fleet.alarm.v1"):
    """What an operator has to look after at a robot, in words that say what to do."""

    robot: Name
    kind: Name = Field(
        description="what is off: scale, unequal, bent, skew, clock, link, mirrored, blind; "
        "frozen, still, lost, carried: the robot is not located while it stands; anchor: there is "
        "no such robot"
    )
    text: Text


class FleetState(
    Message,
    frozen=True,
    schema="fleet.state.v7",
    before="fleet.state.v6",
    at_most=MAX_MESSAGE_BYTES,
):
    """`fleet/state`: everything a late client needs, at a steady rate. v7 tells how deep the scene
    is.
    """

    server_epoch: Epoch
    n: Count
    stamp_ns: Stamp
    anchor: Name | None
    gauge_revision: Count
    up_assumed: bool
    robots: Many[RobotState]
    pairs: Many[PairCell] = Field(
        description="tried or clicked in; two robots without a cell are known through others if "
        "their poses are of one component"
    )
    questions: Many[Question]
    events: Many[Text] = Field(description="the newest 20, oldest first")
    pinned: Many[ViewName] = Field(
        default=(), description="selected views that the server keeps: clicks in them will count"
    )
    alarms: Many[Alarm] = Field(default=(), description="that stand now")
    answered: Many[Answer] = Field(
        default=(), description="the operators' newest answers, the newest last"
    )
    depth_m: Positive | None = Field(
        default=None, description="median depth of all keyframes; none before the first solve"
    )


class ServerStatus(Message, frozen=True, schema="fleet.status.v3", before="fleet.status.v2"):
    """`server/status`: load, queue and drops. v3 says what routers deny and whom they do not let
    in.
    """

    server_epoch: Epoch
    uptime_s: NonNegative
    views: Count
    alignments: Count
    solves: Count
    pending_jobs: Count
    workers: Count
    pairs_per_s: NonNegative
    other_cpu_ms_per_view: NonNegative
    max_pair_wait_s: NonNegative
    drops: dict[Text, Count] = Field(description="count by reason")
    version: Text
    waiting: dict[Text, Count] = Field(
        default={},
        description="pairs in line: joining, unlikely, sharpening; with new clicks; to search "
        "again; to compare by looks; robots with a view to be followed",
    )
    wait_share: NonNegative = Field(
        default=0.0, description="longest wait of a pair in picks, as a share of the bound"
    )
    stage_ms: dict[Text, NonNegative] = Field(
        default={}, description="median of the last times of each stage, server's and workers'"
    )
    picked: Text = Field(default="", description="why the last pair of robots was picked")
    denied: Many[Denial] = Field(
        default=(), description="what the routers' rules did not let pass, the newest kinds first"
    )
    refused: dict[Text, Count] = Field(
        default={}, description="handshakes that failed at the routers, by their cause"
    )


MESSAGES: tuple[type[Message], ...] = tuple(Message.__subclasses__())
"""Every message class; tests walk it."""
