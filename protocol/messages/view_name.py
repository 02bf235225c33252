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
