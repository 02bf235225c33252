"""A real fleet in two pieces behind the page: a pose server, robots in the synthetic world, and one
of them kept from the automatic path.
"""

import contextlib
import tempfile
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import wait_running
from fleetpose.evaluation.options.fleets import OperateOptions
from fleetpose.evaluation.system.fleet import (
    kept_apart,
    observed,
    plan_fleet,
    start,
    wait_started,
)
from fleetpose.evaluation.system.terminal.operate import SETTLE_S, is_asked_about, is_joined
from fleetpose.evaluation.system.web.newcomer import Eyes
from fleetpose.evaluation.system.web.site import WebSite
from fleetpose.protocol.errors import FleetPoseError


class PiecesSite(WebSite):
    """The fleet of `pose-eval operate` with `hmi-client web` before it; use it in a `with`.

    Args:
        out: folder for logs and what the processes keep; emptied before.
        robots: in the fleet; the last one is kept apart.

    Raises:
        FleetPoseError: on entering, a process does not start, or nothing is asked about the last.
    """

    server = "server"

    def __init__(self, out: Path, robots: int = 3) -> None:
        super().__init__(robots, out=out)

    def start_server(self) -> None:
        """Starts the world, the server and the robots, and waits until the question is asked."""
        self._open = contextlib.ExitStack()
        scratch = Path(self._open.enter_context(tempfile.TemporaryDirectory(prefix="fleetpose-")))
        plan = self.plan = plan_fleet(OperateOptions(robots=self.robots).of_fleet(), scratch)
        start(self.fleet, plan, 2, scratch / "state", kept_apart(plan.names, scratch))
        observer = self.observer = self._open.enter_context(observed(self.fleet))
        wait_started(self.fleet, observer, self.robots)
        if not wait_running(self.fleet, lambda: is_asked_about(observer, plan), SETTLE_S):
            raise FleetPoseError(f"after {SETTLE_S:.0f} s nothing is asked about the robot apart")

    def __exit__(self, *raised: Any) -> None:
        with getattr(self, "_open", contextlib.ExitStack()):
            super().__exit__(*raised)

    def is_joined(self, within_s: float) -> bool:
        """Whether the robot that was kept apart is located, at the latest after so long."""
        last = self.plan.names[-1]
        return wait_running(self.fleet, lambda: is_joined(self.observer, last), within_s)

    def eyes(self, pair: tuple[str, str]) -> Eyes:
        """Which pixels of two robots' images show the same.

        Raises:
            FleetPoseError: no view of one was heard.
        """
        i, j = (self.observer.newest_view(robot) for robot in pair)
        if i is None or j is None:
            raise FleetPoseError(f"no view of {pair[0]} or {pair[1]} was heard")
        return Eyes.of(self.plan.truth, i, j)
