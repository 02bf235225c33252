"""Where pairs of images come from: a folder, one stream with both eyes in it, or two."""

import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import CameraError
from fleetpose.robot_agent.cameras.folders.files import read_colour
from fleetpose.robot_agent.cameras.folders.pairing import (
    MAX_SKEW_MS,
    eyes_of,
    list_images,
    paired,
)
from fleetpose.robot_agent.cameras.reader import Reader
from fleetpose.robot_agent.cameras.replay import replay_order
from fleetpose.robot_agent.cameras.stereo.video import (
    Eyes,
    FilePlayer,
    Player,
    VideoSettings,
    is_device,
    open_player,
)

log = logging.getLogger(__name__)

SILENCE_S = 15.0  # longer than a device that was unplugged is waited for
SKEW_PATIENCE_S = 5.0
_POLL_S = 0.1
_TELL_EVERY = 100  # pairs between two lines of the log about their time differences


@dataclass(frozen=True)
class ImagePair:
    """What both eyes saw at one moment, as the cameras gave it.

    Attributes:
        left, right: (H, W, 3) BGR or (H, W) grey, uint8.
        stamp_ns: UTC of the robot's clock when the left one was taken.
        skew_ms: how much later the right one was taken.
    """

    left: npt.NDArray[np.uint8]
    right: npt.NDArray[np.uint8]
    stamp_ns: int
    skew_ms: float = 0.0


class PairSource(Protocol):
    """A source of pairs.

    Attributes:
        name: for errors.
        size: width, height of each image, px.
        own_pace: whether time passes by itself between pairs, as with a device and a video.
        folder: where a calibration may lie beside the images; None for a device.
    """

    name: str
    size: tuple[int, int]
    own_pace: bool
    folder: Path | None

    def pairs(self) -> Iterator[ImagePair]:
        """Yields the newest pair each time, or the next of a folder."""
        ...

    def close(self) -> None:
        """Releases the devices."""
        ...


def open_pairs(
    source: str,
    replay: str,
    video: VideoSettings | None = None,
    stop: threading.Event | None = None,
) -> PairSource:
    """Opens a source of pairs.

    Args:
        source: a folder with `left/` and `right/`; a video file or a device (`0`, `/dev/video0`)
            with both eyes side by side; or two of them, `left,right`.
        replay: `once`, `loop`, `pingpong` or `hold` of a folder; a video knows no `pingpong`; of no
            meaning for devices.
        video: what is asked of devices and videos.
        stop: ends the waiting for a pair.

    Raises:
        DataFolderError: images are missing, or cannot be replayed so.
        CameraError: a device or video cannot be opened, or two of them do not belong together.
    """
    if not source:
        raise DataFolderError("give --data: a folder, a video file, a device, or left,right")
    if Path(source).is_dir() and not is_device(source):
        return PairFolder(Path(source), replay, (video or VideoSettings()).max_skew_ms)
    names = [source]
    if not Path(source).exists() and "," in source:
        names = [name.strip() for name in source.split(",")]
    if len(names) > 2 or not all(names):
        raise DataFolderError(f"'{source}' is no pair: give left,right")
    for name in names:
        if not is_device(name) and not Path(name).is_file():
            raise DataFolderError(f"{name} is neither a folder, a video file nor a device")
    video = video or VideoSettings()
    players: list[Player] = []
    try:
        for name in names:
            players.append(open_player(name, replay, video))
        return PairStream(players, video.max_skew_ms, stop, video.eyes)
    except Exception:
        for player in players:
            player.release()
        raise


class PairFolder:
    """Recorded pairs: images of `left/` and `right/` (or of another layout) that belong together by
    their names or stamps.
    """

    own_pace = False

    def __init__(self, folder: Path, replay: str, max_skew_ms: float = MAX_SKEW_MS) -> None:
        left, right = eyes_of(folder)
        self.name = str(folder)
        self.folder: Path | None = folder
        self._pairs = paired(list_images(left), list_images(right), max_skew_ms)
        height, width = read_colour(self._pairs[0][0]).shape[:2]
        self.size = width, height
        self._order = replay_order(len(self._pairs), replay)

    def pairs(self) -> Iterator[ImagePair]:
        for index in self._order:
            stamp_ns = time.time_ns()
            left, right = (read_colour(path) for path in self._pairs[index])
            yield ImagePair(left, right, stamp_ns)

    def close(self) -> None:
        """Nothing is held open."""


class PairStream:
    """Pairs from one stream, side by side, or from two; always the newest.

    Args:
        players: one or two streams.
        max_skew_ms: see `VideoSettings`.
        stop: ends the waiting for a pair.
        eyes: of one stream, whether both eyes lie beside or below each other in its images.

    Raises:
        CameraError: the streams do not belong together, or one cannot be halved.
    """

    own_pace = True

    def __init__(
        self,
        players: list[Player],
        max_skew_ms: float,
        stop: threading.Event | None = None,
        eyes: Eyes = "side-by-side",
    ) -> None:
        self._rows_first = eyes == "top-bottom"
        _check_together(players, self._rows_first)
        self.name = ",".join(player.name for player in players)
        width, height = players[0].size
        if len(players) == 1:
            width, height = (width, height // 2) if self._rows_first else (width // 2, height)
        self.size = width, height
        self.folder = None if players[0].live else Path(players[0].name).parent
        self._max_skew_ms = max_skew_ms
        self._stop = stop or threading.Event()
        self._changed = threading.Condition()
        self._skews_ms: list[float] = []
        self._dropped = 0
        self._told = False
        self._readers = [Reader(player, self._changed) for player in players]

    def pairs(self) -> Iterator[ImagePair]:
        take = self._halves if len(self._readers) == 1 else self._nearest
        misses_since_s: float | None = None
        while (pair := take()) is not None:
            if abs(pair.skew_ms) <= self._max_skew_ms:
                misses_since_s = None
                self._note(pair)
                yield pair
                continue
            misses_since_s = misses_since_s or time.monotonic()
            self._drop(pair, misses_since_s)

    def close(self) -> None:
        for reader in self._readers:
            reader.close()

    def _halves(self) -> ImagePair | None:
        (reader,) = self._readers
        reader.ask(1)
        self._wait()
        if not reader.stills:
            return None
        still = reader.stills[0]
        one, other = np.split(still.image, 2, axis=0 if self._rows_first else 1)
        return ImagePair(one, other, still.stamp_ns)

    def _nearest(self) -> ImagePair | None:
        """Two images of each eye, and of these the two that were taken closest together: with one
        of each, the pair would be off by a whole period where the request falls between both.
        """
        for reader in self._readers:
            reader.ask(2)
        self._wait()
        while behind := self._behind():
            behind.ask(1, keep=True)
            self._wait()
        left, right = (reader.stills for reader in self._readers)
        if not left or not right:
            return None
        one, other = min(
            ((a, b) for a in left for b in right), key=lambda pair: abs(pair[0].at_s - pair[1].at_s)
        )
        return ImagePair(one.image, other.image, one.stamp_ns, 1e3 * (other.at_s - one.at_s))

    def _behind(self) -> Reader | None:
        """The reader whose images are all older than the other's, if it can go on."""
        left, right = self._readers
        for one, other in ((left, right), (right, left)):
            if one.stills and other.stills and not one.ended and not self._stop.is_set():
                gap_ms = 1e3 * (other.stills[0].at_s - one.stills[-1].at_s)
                if gap_ms > self._max_skew_ms:
                    return one
        return None

    def _wait(self) -> None:
        """Waits until all readers are ready, or until the stop.

        Raises:
            CameraError: no image comes.
        """
        end_s = time.monotonic() + SILENCE_S
        with self._changed:
            while not self._changed.wait_for(self._all_ready, _POLL_S):
                if self._stop.is_set():
                    break
                if time.monotonic() > end_s:
                    raise CameraError(f"{self.name} gave no image for {SILENCE_S:g} s")
        for reader in self._readers:
            if reader.failure is not None:
                raise reader.failure
            if self._stop.is_set():
                reader.stills = []

    def _all_ready(self) -> bool:
        return all(reader.ready for reader in self._readers)

    def _note(self, pair: ImagePair) -> None:
        if len(self._readers) == 1:
            return
        self._skews_ms.append(pair.skew_ms)
        if self._told and len(self._skews_ms) < _TELL_EVERY:
            return
        log.info(
            "pairs source=%s skew_ms=%.1f largest_ms=%.1f of=%d dropped=%d",
            self.name,
            float(np.median(self._skews_ms)),
            float(np.abs(self._skews_ms).max()),
            len(self._skews_ms),
            self._dropped,
        )
        self._told = True
        self._skews_ms, self._dropped = [], 0

    def _drop(self, pair: ImagePair, since_s: float) -> None:
        self._dropped += 1
        log.warning(
            "pair dropped source=%s skew_ms=%.1f allowed_ms=%g",
            self.name,
            pair.skew_ms,
            self._max_skew_ms,
        )
        if time.monotonic() - since_s > SKEW_PATIENCE_S:
            raise CameraError(
                f"the images of {self.name} are {abs(pair.skew_ms):.1f} ms apart, allowed are "
                f"{self._max_skew_ms:g}: synchronise the cameras, let them run faster (--fps), or "
                "allow more with --max-skew-ms if the robot moves slowly"
            )


def _check_together(players: list[Player], rows_first: bool) -> None:
    one, other = players[0], players[-1]
    side = one.size[1] if rows_first else one.size[0]
    if side % 2 and len(players) == 1:
        raise CameraError(
            f"images of {one.name} are {side} px {'high' if rows_first else 'wide'}: not two "
            f"{'below each other' if rows_first else 'side by side'}; give --eyes, or left,right"
        )
    if one.size != other.size:
        raise CameraError(
            f"{one.name} gives {one.size[0]}x{one.size[1]}, {other.name} gives "
            f"{other.size[0]}x{other.size[1]}: both eyes need the same size"
        )
    if one.live != other.live:
        raise CameraError(f"{one.name} and {other.name}: give two devices or two files")
    if isinstance(one, FilePlayer) and isinstance(other, FilePlayer):
        if one.fps != other.fps:
            raise CameraError(
                f"{one.name} runs at {one.fps:g} Hz, {other.name} at {other.fps:g}: give --fps"
            )
        if one.count != other.count:
            raise CameraError(
                f"{one.name} has {one.count} frames, {other.name} has {other.count}: "
                "each needs its partner"
            )
