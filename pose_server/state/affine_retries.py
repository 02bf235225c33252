"""Pairs that wait for affine keypoints."""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field

from fleetpose.pose_server.workers.jobs import Done
from fleetpose.protocol.messages import ViewName

MOST_SETS = 64  # about 250 kB each
MOST_WAITING = 200


@dataclass
class AffineRetries:
    """What waits for wide sets.

    Attributes:
        sets: encoded views with wide sets, the latest used last.
        waiting: results that are not settled, by their views.
        asked: views that robots were asked for.
        declined: views whose robots have none.
    """

    sets: OrderedDict[ViewName, bytes] = field(default_factory=OrderedDict)
    waiting: dict[tuple[ViewName, ViewName], Done] = field(default_factory=dict)
    asked: set[ViewName] = field(default_factory=set)
    declined: dict[ViewName, None] = field(default_factory=dict)
    tries: dict[tuple[str, str], int] = field(default_factory=dict)

    def of(self, view: ViewName) -> bytes | None:
        """The wide set of a view, if there is one."""
        if view in self.sets:
            self.sets.move_to_end(view)
        return self.sets.get(view)

    def wait(self, done: Done) -> None:
        """A result waits for the wide sets of its views."""
        i, j = done.job.views
        self.waiting[i, j] = done
        self.tries[i.robot, j.robot] = self.tries.get((i.robot, j.robot), 0) + 1

    def take(self, views: tuple[ViewName, ViewName]) -> None:
        """A result waits no more."""
        del self.waiting[views]

    def ask(self, views: Iterable[ViewName]) -> None:
        """Robots are asked for the wide sets of views."""
        self.asked.update(views)

    def answer(self, view: ViewName, payload: bytes | None) -> None:
        """A robot has answered: with a view's wide set, or that there is none."""
        self.asked.discard(view)
        if payload is not None:
            self.sets[view] = payload
            while len(self.sets) > MOST_SETS:
                self.sets.popitem(last=False)
            return
        self.declined[view] = None
        self.declined = dict.fromkeys(list(self.declined)[-MOST_WAITING:])
        self.waiting = {views: done for views, done in self.waiting.items() if view not in views}
