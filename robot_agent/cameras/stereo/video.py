"""One stream of images from a V4L2 device or a video file, both through `cv2.VideoCapture`.

A file is played as a device would give it: at its own pace, whatever the reader's.
"""

import logging
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import CameraError

log = logging.getLogger(__name__)

Image = npt.NDArray[np.uint8]
Opener = Callable[..., Any]  # as cv2.VideoCapture; tests put a device of their own there

Eyes = Literal["side-by-side", "top-bottom"]

VIDEO_REPLAYS = ("once", "loop", "hold")
RECONNECT_S = 10.0
_RETRY_S = 0.5
_OLDEST_S = 1.0  # an image just grabbed from a queue that is always emptied
_LATE_S = 1.0  # a file decoded more slowly than it plays is said to be
_DEVICES = Path("/dev")


@dataclass(frozen=True)
class VideoSettings:
    """What is asked of a stream; None leaves it as the device or the file has it.

    Attributes:
        size: width, height of its images, px; both eyes together where they come side by side.
        fps: of a device, asked for; of a file, the pace it is played at instead of its own.
        fourcc: how a device codes its images, e.g. `MJPG`.
        max_skew_ms: images of two streams that were taken further apart are no pair.
        eyes: how both lie in one image.
    """

    size: tuple[int, int] | None = None
    fps: float | None = None
    fourcc: str | None = None
    max_skew_ms: float = 10.0
    eyes: Eyes = "side-by-side"


def video_settings(
    size: str | None,
    fps: float | None,
    fourcc: str | None,
    max_skew_ms: float,
    eyes: Eyes = "side-by-side",
) -> VideoSettings:
    """The settings with the size as it is written, `WIDTHxHEIGHT`.

    Raises:
        CameraError: the size is none.
    """
    if size is None:
        return VideoSettings(None, fps, fourcc, max_skew_ms, eyes)
    width, _, height = size.partition("x")
    if not width.isdigit() or not height.isdigit():
        raise CameraError(f"'{size}' is no size: give WIDTHxHEIGHT")
    return VideoSettings((int(width), int(height)), fps, fourcc, max_skew_ms, eyes)


class Instant(NamedTuple):
    """When an image was taken: s on a clock that all streams of a kind share, and UTC of the
    robot's clock.
    """

    at_s: float
    stamp_ns: int


class Player(Protocol):
    """A stream that is read from one thread.

    Attributes:
        name: for errors and the log.
        size: width, height of its images, px.
        live: whether it runs by itself, so that images that nobody takes must be taken away.
    """

    name: str
    size: tuple[int, int]
    live: bool

    def grab(self) -> Instant | None:
        """Waits for the next image; None at the end.

        Raises:
            CameraError: it has stopped.
        """
        ...

    def retrieve(self) -> Image | None:
        """Decodes the image grabbed last: (H, W, 3) BGR or (H, W); None where it is damaged."""
        ...

    def interrupt(self) -> None:
        """Ends the waiting of `grab`, from any thread."""
        ...

    def release(self) -> None:
        """Gives the device back, in the reading thread or when there is none."""
        ...


def open_player(
    source: str, replay: str, settings: VideoSettings, opener: Opener = cv2.VideoCapture
) -> Player:
    """Opens a device (`0`, `/dev/video0`, `/dev/v4l/by-id/...`) or a video file.

    Args:
        source: the device or the file.
        replay: `once`, `loop` or `hold` of a file; of no meaning for a device.
        settings: what is asked of it.
        opener: what opens it, called as `cv2.VideoCapture(source, backend)`.

    Raises:
        CameraError: it does not exist, cannot be opened, or does not give what is asked for.
        DataFolderError: a video cannot be replayed so.
    """
    if is_device(source):
        return DevicePlayer(source, settings, opener)
    return FilePlayer(source, replay, settings, opener)


def is_device(source: str) -> bool:
    """Whether a source names a device: a number, or a path in /dev."""
    return source.isdigit() or Path(source).is_relative_to(_DEVICES)


class FilePlayer:
    """A video file; its clock starts with the first grab."""

    live = False

    def __init__(
        self, source: str, replay: str, settings: VideoSettings, opener: Opener = cv2.VideoCapture
    ) -> None:
        if replay not in VIDEO_REPLAYS:
            raise DataFolderError(
                f"replay '{replay}' needs a folder of images: a video is replayed "
                f"{', '.join(VIDEO_REPLAYS)}"
            )
        self.name = source
        self._replay = replay
        self._open: Callable[[], Any] = lambda: opener(source, cv2.CAP_FFMPEG)
        self._capture = self._open()
        if not self._capture.isOpened():
            raise CameraError(f"{source} cannot be read as a video")
        self.size = _size_of(self._capture)
        _check_size(self.name, self.size, settings.size)
        self.fps = settings.fps or float(self._capture.get(cv2.CAP_PROP_FPS))
        if not 0 < self.fps <= 1000:
            raise CameraError(f"{source} does not say its frames per second: give --fps")
        self.count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))  # <= 0: not told
        self._number = 0
        self._began_s: float | None = None
        self._interrupted = threading.Event()
        self._told_late = False

    def grab(self) -> Instant | None:
        if not self._advance():
            return None
        if self._began_s is None:
            self._began_s = time.monotonic()
        media_s = self._number / self.fps
        self._number += 1
        early_s = self._began_s + media_s - time.monotonic()
        if early_s < -_LATE_S and not self._told_late:
            self._told_late = True
            log.warning("video %s is decoded more slowly than its %g Hz", self.name, self.fps)
        if self._interrupted.wait(max(early_s, 0.0)):
            return None
        return Instant(media_s, time.time_ns())

    def retrieve(self) -> Image | None:
        good, image = self._capture.retrieve()
        return image if good else None

    def interrupt(self) -> None:
        self._interrupted.set()

    def release(self) -> None:
        self._capture.release()

    def _advance(self) -> bool:
        if self._replay == "hold" and self._number:
            return True  # the image grabbed first can be retrieved again and again
        if self._capture.grab():
            return True
        if self._number == 0:
            raise CameraError(f"{self.name} holds no image")
        if self._replay != "loop":
            return False
        self._capture.release()  # not every file can be wound back
        self._capture = self._open()
        return bool(self._capture.grab())


class DevicePlayer:
    """A V4L2 device; one that stops is opened again for some seconds."""

    live = True

    def __init__(
        self, source: str, settings: VideoSettings, opener: Opener = cv2.VideoCapture
    ) -> None:
        self.name = f"/dev/video{source}" if source.isdigit() else source
        self._settings = settings
        self._opener = opener
        self._interrupted = threading.Event()
        self._capture = self._opened()
        self.size = _size_of(self._capture)

    def grab(self) -> Instant | None:
        if not self._capture.grab() and not self._reopen():
            return None
        now_s, now_ns = time.monotonic(), time.time_ns()
        age_s = now_s - float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
        if not 0 <= age_s < _OLDEST_S:
            age_s = 0.0  # the driver stamps its images by another clock, or not at all
        return Instant(now_s - age_s, now_ns - round(1e9 * age_s))

    def retrieve(self) -> Image | None:
        good, image = self._capture.retrieve()
        return image if good and image is not None and image.shape[1::-1] == self.size else None

    def interrupt(self) -> None:
        self._interrupted.set()

    def release(self) -> None:
        self._capture.release()

    def _opened(self) -> Any:
        if self._opener is cv2.VideoCapture:
            _check_device(self.name)
        capture = self._opener(self.name, cv2.CAP_V4L2)
        if not capture.isOpened():
            raise CameraError(f"{self.name} cannot be opened: it is in use, or gives no images")
        asked = self._settings
        if asked.fourcc is not None:  # before the size: which sizes there are depends on it
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*asked.fourcc))
        if asked.size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, asked.size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, asked.size[1])
        if asked.fps is not None:
            capture.set(cv2.CAP_PROP_FPS, asked.fps)
        try:
            _check_size(self.name, _size_of(capture), asked.size)
        except CameraError:
            capture.release()
            raise
        log.info(
            "camera device=%s size=%dx%d fps=%g fourcc=%s",
            self.name,
            *_size_of(capture),
            capture.get(cv2.CAP_PROP_FPS),
            _fourcc_of(capture),
        )
        return capture

    def _reopen(self) -> bool:
        """Waits for a device that was unplugged; False when interrupted.

        Raises:
            CameraError: it does not come back.
        """
        log.warning("camera stopped device=%s: waiting %g s for it", self.name, RECONNECT_S)
        self._capture.release()
        end_s = time.monotonic() + RECONNECT_S
        while not self._interrupted.wait(_RETRY_S):
            try:
                self._capture = self._opened()
                if self._capture.grab():
                    return True
                self._capture.release()
            except CameraError as error:
                log.debug("camera still away: %s", error)
            if time.monotonic() > end_s:
                raise CameraError(
                    f"{self.name} stopped giving images and did not come back in "
                    f"{RECONNECT_S:g} s: check its plug and cable; {_there()}"
                )
        return False


def _check_device(path: str) -> None:
    if not Path(path).exists():
        raise CameraError(f"there is no camera {path}; {_there()}")
    if not os.access(path, os.R_OK | os.W_OK):
        raise CameraError(f"{path} may not be used: add this user to the group 'video'")


def _there() -> str:
    devices = sorted(_DEVICES.glob("video[0-9]*"))
    if not devices:
        return "no video device is there at all"
    return "there are " + ", ".join(f"{path} ({_title(path)})" for path in devices)


def _title(device: Path) -> str:
    try:
        return Path("/sys/class/video4linux", device.name, "name").read_text().strip()
    except OSError:
        return "?"


def _size_of(capture: Any) -> tuple[int, int]:
    return (
        int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
        int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
    )


def _check_size(name: str, given: tuple[int, int], asked: tuple[int, int] | None) -> None:
    if asked is not None and given != asked:
        raise CameraError(
            f"{name} gives images of {given[0]}x{given[1]}, not {asked[0]}x{asked[1]} as asked "
            "with --size; 'v4l2-ctl --list-formats-ext' shows what a device can"
        )


def _fourcc_of(capture: Any) -> str:
    code = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    return code.to_bytes(4, "little").decode("ascii", "replace").strip("\0") or "?"
