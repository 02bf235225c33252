"""What is told of the network itself: what the server hears of a robot, what routers deny."""

from pydantic import Field

from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import Count, Epoch, Many, Name, NonNegative, Text


class Heard(Message, frozen=True, schema="fleet.heard.v1"):
    """`heard/<robot>`: what the server has of a robot, told to that robot at each of its views and
    once a second. It acknowledges: what a router denies, its sender learns nowhere else.
    """

    robot: Name
    epoch: Epoch | None = Field(description="the life of the newest view it took; none without")
    seq: Count | None = Field(description="of that view")
    waited_s: NonNegative = Field(
        default=0.0, description="that the view lay at the server until it was told"
    )
    drops: dict[Text, Count] = Field(description="what was refused of the robot, by reason")
    version: Text = Field(description="of the server")
    reads: Many[Text] = Field(description="all versions that it reads of what robots send")
    server_epoch: Epoch
    n: Count = Field(description="counts up per robot and server epoch")


class Denial(Message, frozen=True, schema="fleet.denial.v1"):
    """One kind of thing that a router's rules do not let pass."""

    who: Text = Field(description="name in the certificate; without one the session's id")
    what: Text = Field(description="e.g. put, query, liveliness token")
    key: Text
    n: Count = Field(description="how often, since the router's start")


class Denials(Message, frozen=True, schema="fleet.denials.v1"):
    """`router/<name>/denials`: what a router's rules did not let pass, and who was not let in."""

    router: Name
    epoch: Epoch = Field(description="of this life of the router")
    denied: Many[Denial] = Field(description="the 200 most frequent, since its start")
    refused: dict[Text, Count] = Field(description="handshakes that failed, by their cause")
