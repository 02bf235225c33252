"""A robot's agent as it always is, on a machine whose clock can be set: all its stamps are what the
camera gave and so many nanoseconds more as a file says.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from fleetpose.robot_agent.__main__ import main as run_agent
from fleetpose.robot_agent.cameras import synthetic
from fleetpose.robot_agent.cameras.base import Camera, Frame

MODULE = "fleetpose.evaluation.system.soak.stepping"


class Stepped:
    """A camera on such a machine.

    Args:
        camera: the true one.
        clock: the file, nanoseconds; it may change at any time.
    """

    def __init__(self, camera: Camera, clock: Path) -> None:
        self._camera, self._clock = camera, clock

    def frames(self) -> Iterator[Frame]:
        for frame in self._camera.frames():
            ahead_ns = int(self._clock.read_text())
            yield replace(frame, stamp_ns=frame.stamp_ns + ahead_ns)

    def close(self) -> None:
        self._camera.close()


def set_clock(clock: Path, ahead_ns: int) -> None:
    """Sets it in one step, so that an agent never reads half a number."""
    part = clock.with_suffix(".part")
    part.write_text(str(ahead_ns))
    part.replace(clock)


def main() -> None:
    """Arguments CLOCK and those of `robot-agent`."""
    clock, opened = Path(sys.argv.pop(1)), synthetic.open_camera

    def open_camera(source: str, replay: str) -> Stepped:
        return Stepped(opened(source, replay), clock)

    setattr(synthetic, "open_camera", open_camera)  # noqa: B010 - the agent opens it by this name
    run_agent()


if __name__ == "__main__":
    main()
