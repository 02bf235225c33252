"""Everything that a site says on its keys, into a recording.

Who records only hears: it puts nothing, asks nothing and shows no token. Callbacks copy a message
into a bounded queue; a thread writes. What finds no room is counted, so that nobody waits for the
disk.
"""

import resource
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Recorder, RecordingError
from fleetpose.protocol.text import release
from fleetpose.protocol.transport import Link, Sample

_LOOK_S = 1.0


@dataclass(frozen=True)
class Progress:
    """How far a recording has come.

    Attributes:
        views: clouds of robots.
        bytes: of the file so far.
        cpu_ms: of this process since it listens, by view; and of these, that writing took.
    """

    seconds: float
    views: int
    messages: int
    bytes: int
    left_out: int
    cpu_ms: float
    writing_cpu_ms: float

    def __str__(self) -> str:
        lost = f", {self.left_out} left out" if self.left_out else ""
        return f"{self.views} views, {self.bytes / 1e6:.1f} MB, {self.seconds:.0f} s{lost}"

    @property
    def cost(self) -> str:
        """What a view costs."""
        if not self.views:
            return "no view came"
        return (
            f"a view: {1e-3 * self.bytes / self.views:.0f} kB, {self.writing_cpu_ms:.2f} ms CPU to "
            f"write, {self.cpu_ms:.2f} ms with listening"
        )


class SiteRecorder:
    """Records a site from now on.

    Args:
        link: to the site; closed by who opened it.
        keys: of the site.
        path: the file; it must not exist.
        images: whether robots are to send their images as well, which they do only where somebody
            listens.

    Raises:
        RecordingError: the file is there already, or cannot be written.
    """

    def __init__(self, link: Link, keys: Keys, path: Path, images: bool = True) -> None:
        self._path = path
        self._views = 0
        self._began_s, self._began_cpu_s = time.monotonic(), _cpu_s()
        # compressing clouds and images again costs a millisecond a view and saves 2 % of the file
        library = f"pose-server {release()}"
        self.recorder = Recorder(path, keys.site, library=library, compressed=False)
        for key_expr in (keys.robot_alive("*", "*"), keys.server_alive("*")):
            link.on_alive(key_expr, self.recorder.token)
        for key_expr in _latched(keys):
            link.on_latched(key_expr, self._heard)
        self._bulk = [link.subscribe_bulk(keys.cloud("*"), self._viewed)]
        if images:
            self._bulk.append(link.subscribe_bulk(keys.image("*"), self._heard))

    def run(
        self, stop: threading.Event, seconds: float | None, tell: Callable[[Progress], None]
    ) -> Progress:
        """Records until told to stop, or for so long; tells once a second how far it is.

        Raises:
            RecordingError: the disk is full.
        """
        while not stop.wait(_LOOK_S):
            now = self.progress()
            tell(now)
            if self.recorder.failure is not None:
                raise RecordingError(self.recorder.failure)
            if seconds is not None and now.seconds >= seconds:
                break
        return self.close()

    def progress(self) -> Progress:
        """How far it is."""
        views = max(self._views, 1)
        return Progress(
            time.monotonic() - self._began_s,
            self._views,
            self.recorder.written,
            self._path.stat().st_size,
            self.recorder.left_out,
            1e3 * (_cpu_s() - self._began_cpu_s) / views,
            1e3 * self.recorder.cpu_s / views,
        )

    def close(self) -> Progress:
        """Ends the file."""
        for one in self._bulk:
            one.undeclare()
        self._bulk.clear()
        self.recorder.close()
        return self.progress()

    def _heard(self, sample: Sample) -> None:
        self.recorder.note("in", sample)

    def _viewed(self, sample: Sample) -> None:
        self._views += 1
        self.recorder.note("in", sample)


def _latched(keys: Keys) -> tuple[str, ...]:
    """What is kept by who says it: key by key, because rules of a site know no wider ones."""
    return (
        *(keys.camera("*"), keys.odometry("*")),
        *(keys.updates("*"), keys.selection("*"), keys.receipts("*")),
        *(keys.poses, keys.state, keys.status, keys.heard("*"), keys.denials("*")),
        *(keys.alignment("*", "*"), keys.correspondences("*", "*")),
    )


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
