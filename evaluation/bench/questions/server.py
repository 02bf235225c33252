"""A pose server of one drawn fleet, without network, that an operator clicks in."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetpose.evaluation.bench.offline.server import SESSION, OfflineServer
from fleetpose.evaluation.bench.pairs.worker import of_wide
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.workers.jobs import Done, PairJob
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import OperatorUpdate, Selection

if TYPE_CHECKING:
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult

OPERATOR = "op-simulated"
RobotPair = tuple[str, str]
LOOKED_S = 10.0  # that an operator takes to see that two images have nothing to click


class FleetServer(OfflineServer):
    """The server of a still fleet of which all pairs were aligned automatically.

    Args:
        wires: what the robots sent, by index of their views; the wide sets lie beside.
        results: automatic alignment of each pair of robots, by their names in order.
    """

    def __init__(
        self, wires: Mapping[int, Path], results: Mapping[RobotPair, "PairResult"]
    ) -> None:
        super().__init__(wires)
        self._sent = 0
        for index, wire in wires.items():
            if of_wide(wire).exists():
                name = self.view(self.names[index])
                self.site.affine_retries.sets[name] = of_wide(wire).read_bytes()
        for (a, b), result in results.items():
            i, j = self.view(a), self.view(b)
            job = PairJob(self.site.encoded(i), self.site.encoded(j))
            pipeline.take_result(self.site, Done(job, result), 0.0)
        for record in self.site.pairs.values():
            record.untried.clear()
        self.solve()

    def is_verified(self, robot: str) -> bool:
        """Whether only verified alignments hang it on the anchor."""
        assert self.site.solution is not None
        return self.site.solution.nodes[self.view(robot)].verdict == "verified"

    def visit(self, pair: RobotPair, clicks: Iterable[tuple[Floats, Floats]]) -> None:
        """The operator takes a pair on the screen, clicks the same points (2,) in both views, and
        goes on; the server does all that follows.
        """
        self._select(pair)
        for pixel_i, pixel_j in clicks:
            self._sent += 1
            update = OperatorUpdate(
                operator=OPERATOR,
                session=SESSION,
                n=self._sent,
                action="add",
                i=pair[0],
                j=pair[1],
                base_revision=0,
                view_i=self.view(pair[0]),
                view_j=self.view(pair[1]),
                pixel_i=np.asarray(pixel_i),
                pixel_j=np.asarray(pixel_j),
            )
            pipeline.receive_update(self.site, update)
        self._now_s += LOOKED_S
        self._select(None)
        while (job := self._next_job()) is not None:
            self._do(job)
        self.site.want_solution()
        self.solve()

    def _select(self, pair: RobotPair | None) -> None:
        i, j = (None, None) if pair is None else pair
        views = [None if name is None else self.view(name) for name in (i, j)]
        selection = Selection(
            operator=OPERATOR, session=SESSION, i=i, j=j, view_i=views[0], view_j=views[1]
        )
        pipeline.receive_selection(self.site, selection, self._now_s)


def named_pairs(names: Sequence[str]) -> list[RobotPair]:
    """All pairs of robots, in order of their names."""
    ordered = sorted(names)
    return [ordered_pair(a, b) for k, a in enumerate(ordered) for b in ordered[k + 1 :]]
