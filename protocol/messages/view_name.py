"""How a view is named."""

from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import Count, Epoch, Name


class ViewName(Message, frozen=True, schema="fleet.view_name.v1"):
    """One moment of one robot: image and cloud of it carry the same name."""

    robot: Name
    epoch: Epoch
    seq: Count

    def __str__(self) -> str:
        return f"{self.robot}/{self.epoch}/{self.seq}"

    # The key of most dictionaries of the server: what pydantic makes takes ten times as long.
    def __hash__(self) -> int:
        return hash((self.robot, self.epoch, self.seq))

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, ViewName)
            and self.seq == other.seq
            and self.robot == other.robot
            and self.epoch == other.epoch
        )
