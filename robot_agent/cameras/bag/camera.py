"""Plays a bag: what it recorded, at the pace at which it was recorded."""

import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.bag.recording import BagRecording, with_next
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.rosmsg.bag import Bag, Recorded
from fleetpose.rosmsg.stamps import Moment

log = logging.getLogger(__name__)

_ROUNDS = ("once", "loop", "hold")


class BagCamera:
    """A bag as a camera: each time the newest frame that was taken by now.

    Args:
        recording: the bag.
        replay: `once`, `loop` or `hold`. Stamps go on growing in a loop: the recording's length is
            added each time round.
        speed: how fast; None: each frame in turn, when it is asked for.
        stop: ends the waiting for the next frame.
    """

    def __init__(
        self,
        recording: BagRecording,
        replay: str = "once",
        speed: float | None = 1.0,
        stop: threading.Event | None = None,
    ) -> None:
        if replay not in _ROUNDS:
            raise DataFolderError(f"a bag is played {', '.join(_ROUNDS)}, not {replay}")
        self.recording = recording
        self._replay, self._speed = replay, speed
        self._stop = stop or threading.Event()

    def frames(self) -> Iterator[Frame]:
        if self._replay == "hold":
            yield from self._held()
            return
        later_ns, shown = 0, True
        while shown and not self._stop.is_set():
            stamps: list[int] = []
            shown = False
            for frame in self._once(stamps):
                shown = True
                yield replace(frame, stamp_ns=frame.stamp_ns + later_ns) if later_ns else frame
            self._log_end(len(stamps))
            if self._replay == "once":
                return
            later_ns += _length_ns(stamps)

    def close(self) -> None:
        self.recording.close()

    def _once(self, stamps: list[int]) -> Iterator[Frame]:
        """The frames of one round; of all moments the stamps, also of those that are passed over
        because a newer one is due.
        """
        begin_s = 0.0
        for moment, following in with_next(self.recording.moments()):
            begin_s = begin_s or time.monotonic()
            stamps.append(moment.stamp_ns)
            if following is not None and self._due_in_s(following, stamps[0], begin_s) <= 0:
                continue
            wait_s = self._due_in_s(moment, stamps[0], begin_s)
            if wait_s > 0 and self._stop.wait(wait_s):
                return
            if (frame := self.recording.frame(moment)) is not None:
                yield frame

    def _due_in_s(self, moment: Moment[Recorded], first_ns: int, begin_s: float) -> float:
        if self._speed is None:
            return 1e-9
        due_s = 1e-9 * (moment.stamp_ns - first_ns) / self._speed
        return begin_s + due_s - time.monotonic()

    def _held(self) -> Iterator[Frame]:
        """The first frame again and again, as of a robot that stands."""
        first = next(self.recording.frames(), None)
        begin_ns = time.monotonic_ns()
        while first is not None and not self._stop.is_set():
            later_ns = time.monotonic_ns() - begin_ns
            yield replace(first, stamp_ns=first.stamp_ns + later_ns)

    def _log_end(self, moments: int) -> None:
        pairing = self.recording.pairing
        log.info(
            "bag played moments=%d without_partner=%d largest_skew_ms=%.1f",
            *(moments, pairing.dropped, 1e-6 * max(pairing.skews_ns, default=0)),
        )


def _length_ns(stamps: list[int]) -> int:
    """From the first frame to one after the last."""
    span_ns = stamps[-1] - stamps[0] if stamps else 0
    return span_ns + (span_ns // (len(stamps) - 1) if len(stamps) > 1 else 10**9)


def open_camera(
    source: str,
    replay: str,
    calibration: Path | None = None,
    bag: BagOptions | None = None,
    stop: threading.Event | None = None,
    translation_unit: float | None = None,
) -> BagCamera:
    """Opens a bag as a camera.

    Args:
        source: a file (.mcap, .db3, .bag), a folder, or several with commas between.
        replay: `once`, `loop` or `hold`.
        calibration: in place of its infos.
        bag: which topics, and how it is played.
        stop: ends the waiting for the next frame.
        translation_unit: metres that one of the calibration's translation is; None: metres.

    Raises:
        DataFolderError: it cannot be read, or there is no camera in it.
        CalibrationError: its infos cannot be used.
    """
    options = bag or BagOptions()
    opened = Bag(source)
    try:
        recording = BagRecording(opened, options, calibration, translation_unit)
        camera = BagCamera(recording, replay, options.speed, stop)
    except Exception:
        opened.close()
        raise
    roles = recording.roles
    log.info("bag form=%s image=%s ranges=%s", roles.form, roles.image, roles.ranges)
    if recording.mounting.why_not:
        log.warning(
            "%s: the camera is taken to stand at the robot's origin and to look ahead: %s",
            *(source, recording.mounting.why_not),
        )
    return camera
