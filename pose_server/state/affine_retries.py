"""Pairs that wait for affine keypoints."""

from collections import OrderedDict
from dataclasses import dataclass, field

from fleetpose.pose_server.workers.jobs import Done
from fleetpose.protocol.messages import ViewName


@dataclass
class AffineRetries:
    """What waits for wide sets.

    Attributes:
        sets: encoded views with wide sets, the latest used last.
        waiting: results that are not settled, by their views.
        asked: views that robots were asked for.
        refused: views whose robots have none.
    """

    sets: OrderedDict[ViewName, bytes] = field(default_factory=OrderedDict)
    waiting: dict[tuple[ViewName, ViewName], Done] = field(default_factory=dict)
    asked: set[ViewName] = field(default_factory=set)
    refused: dict[ViewName, None] = field(default_factory=dict)
    tries: dict[tuple[str, str], int] = field(default_factory=dict)

    def of(self, view: ViewName) -> bytes | None:
        """The wide set of a view, if there is one."""
        if view in self.sets:
            self.sets.move_to_end(view)
        return self.sets.get(view)

    def close(self, view: ViewName) -> None:
        """Nothing waits for a view any more."""
        self.waiting = {views: done for views, done in self.waiting.items() if view not in views}
