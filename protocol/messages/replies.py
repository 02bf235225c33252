"""Replies of the server: where one robot is, seen from another, and why one is not located."""

from pydantic import Field

from fleetpose.protocol.messages.arrays import Matrix6, Pose
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import Many, Name, NonNegative, Probability, Text, Verdict


class RelativePose(
    Message, frozen=True, schema="fleet.relative_pose.v2", before="fleet.relative_pose.v1"
):
    """Reply of `server/relative?from=a;to=b`. v2 says whether it may be acted on; what v1 leaves
    out counts as no.
    """

    a: Name
    b: Name
    T_a_b: Pose = Field(description="robot body frames")
    covariance: Matrix6 = Field(
        description="left perturbation of T_a_b; grown by what either may have moved unseen"
    )
    age_s: NonNegative = Field(description="of the older of the two views, by the server's clock")
    through: Many[Name]
    verdict: Verdict = Field(
        default="ambiguous", description="of the weakest link that holds either of them"
    )
    located: bool = Field(default=False, description="whether both robots are")
    p_grave: Probability | None = Field(
        default=None,
        description="that it is gravely off: that one of the links on the way is; none where "
        "nothing is known of that, as where clicks alone link two robots",
    )
    why_not: Text = Field(
        default="", description="why they are not both located, as operators read it"
    )


class WhyNot(Message, frozen=True, schema="fleet.why_not.v1"):
    """Reply of `server/why?robot=a`: what operators are told of a robot."""

    robot: Name
    located: bool
    why_not: Text = Field(description="why it is not located; empty if it is")
    alarms: Many[Text] = Field(description="what is off at it, each with what to do")
