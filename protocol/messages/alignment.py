"""What the server says of the alignment of a pair."""

from typing import Annotated, Literal

from pydantic import Field

from fleetpose.protocol.messages.arrays import Matrix6, Pose
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import (
    Count,
    Epoch,
    Many,
    Name,
    NonNegative,
    Probability,
    Text,
    Verdict,
)
from fleetpose.protocol.messages.view_name import ViewName


class OperatorFit(Message, frozen=True, schema="fleet.operator_fit.v1"):
    """The pose that an operator's correspondences give by themselves, by Direct Linear
    Transformation, and what is left to it: T_j_i = T_j_i_refine @ T_j_i_operator.
    """

    T_j_i_operator: Pose = Field(
        description="the rigid motion nearest to the model: H* of the paper"
    )
    T_j_i_refine: Pose | None = Field(description="H' of the paper; none if no pose was found")
    model: Name = Field(
        description="the largest that the points determine: translation, upright (by gravity in "
        "both views), rigid, affine or projective"
    )
    correspondences: Many[Count] = Field(description="ids of those that it grew from")


class IcpFit(Message, frozen=True, schema="fleet.icp_fit.v1"):
    """What the Iterative Closest Point algorithm did to a pair."""

    method: Literal["gicp", "point_to_point", "point_to_plane"]
    error_m2: NonNegative = Field(description="sum of squared distances that it left")
    rms_m: NonNegative
    count: Count = Field(description="points with a partner")
    ms: NonNegative
    kept: bool = Field(description="the pose is what it made of it; else that was worse")


class Alignment(Message, frozen=True, schema="fleet.alignment.v3", before="fleet.alignment.v2"):
    """`pair/<i>/<j>/alignment`: the newest alignment of a pair, i < j. v3 tells what clicks and ICP
    contributed.
    """

    view_i: ViewName
    view_j: ViewName
    T_i_j: Pose | None = Field(
        description="camera of view j in camera of view i; none if not found"
    )
    covariance: Matrix6 | None
    information: Matrix6 | None
    verdict: Verdict
    reasons: Many[Text]
    regression_error_m2: NonNegative
    regression_count: Count
    rmse_m: NonNegative
    overlap: NonNegative
    inliers: Count
    start: Name = Field(
        description="the start it grew from: operator, dlt, previous, graph, features, wide, "
        "shape, identity"
    )
    timings_ms: dict[Text, NonNegative]
    p_grave: Probability = Field(1.0, description="that T_i_j is gravely off, by all evidence")
    rivals: Annotated[tuple[Pose, ...], Field(max_length=16)] = Field(
        (), description="other T_i_j that the images support as well"
    )
    operator: OperatorFit | None = Field(None, description="none where nobody clicked")
    icp: IcpFit | None = Field(None, description="none where it was not tried")
    server_epoch: Epoch
    n: Count
