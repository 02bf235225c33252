"""The orders in which a recording's frames can be shown."""

from collections.abc import Iterator
from typing import Literal, get_args

from fleetpose.protocol.errors import DataFolderError

ReplayMode = Literal["once", "loop", "pingpong", "hold"]


def replay_order(count: int, replay: str) -> Iterator[int]:
    """Indices of a recording's frames.

    Args:
        count: frames of the recording, at least one.
        replay: `once` ends after the last; `loop` starts over; `pingpong` goes forward and
            backward, the frames at the ends once each time; `hold` shows the first for ever.

    Raises:
        DataFolderError: no frames, or a mode that does not exist.
    """
    if count < 1:
        raise DataFolderError("a recording without frames cannot be replayed")
    if replay not in get_args(ReplayMode):
        raise DataFolderError(
            f"replay '{replay}' does not exist: use {', '.join(get_args(ReplayMode))}"
        )
    return _indices(count, replay)


def _indices(count: int, replay: str) -> Iterator[int]:
    forward = range(count)
    if replay == "hold":
        forward = range(1)
    yield from forward
    if replay == "once":
        return
    backward = reversed(range(1, count - 1)) if replay == "pingpong" else ()
    again = [*backward, *forward]
    while True:
        yield from again
