"""What the operator is asked, and what the answers did."""

from typing import Annotated

from pydantic import Field

from fleetpose.protocol.messages.arrays import Pixel
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import Count, Many, Name, NonNegative, Text
from fleetpose.protocol.messages.view_name import ViewName


class Suggestion(Message, frozen=True, schema="fleet.suggestion.v1"):
    """Two pixels that may show the same point; nothing vouches for it but an operator."""

    pixel_i: Pixel
    pixel_j: Pixel


class Question(Message, frozen=True, schema="fleet.question.v2", before="fleet.question.v1"):
    """What the operator is asked, best first. v2 has suggestions."""

    i: Name
    j: Name
    view_i: ViewName
    view_j: ViewName
    reason: Text
    gain: NonNegative = Field(
        description="expected drop of the fleet's position sigma, m per click"
    )
    suggestions: Many[Suggestion] = Field(
        default=(), description="points to confirm in these two views, best first"
    )


class Answer(Message, frozen=True, schema="fleet.answer.v1"):
    """What an operator's clicks in a pair did, beside what was expected of them."""

    i: Name
    j: Name
    clicks: Count = Field(description="correspondences added")
    predicted: NonNegative = Field(description="drop of the fleet's mean position sigma, m")
    realised: Annotated[float, Field(allow_inf_nan=False)] = Field(
        description="the same after them, m; negative where they revealed that less is known"
    )
    joined: Many[Name] = Field(description="robots that were not joined to the anchor before")
    text: Text
