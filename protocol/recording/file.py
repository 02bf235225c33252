"""What was said on the wire, in an MCAP file: each message as it was, to the bit, at its time.

A topic is the key of the message, its encoding the one on the wire. What zenoh carries beside the
payload stands before it under `<key>/attachment`. Which way a message went is in its channel's
metadata; whose the recording is, in the file's. A token that came or went is a message too.

Format: https://mcap.dev/spec
"""

import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import Full, Queue
from typing import IO, Literal

from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import CompressionType, Writer
from zstandard import ZstdError

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages.base import MAX_MESSAGE_BYTES
from fleetpose.protocol.slots import Sample

Way = Literal["in", "answer", "out", "token"]
WAYS: tuple[Way, ...] = ("in", "answer", "out", "token")
NAME = "fleetpose-session"
HERE, GONE = b"here", b"gone"  # of a token
_CHUNK_BYTES = 1 << 20
_PAUSE_S = 0.8  # a kill may cost the file a second; to wake up costs as much as several samples
_WAITING = 50_000  # samples on their way to the disk; more are left out and counted
_WAITING_BYTES = 256 * 1024 * 1024
_MAX_RECORD_BYTES = 4 * MAX_MESSAGE_BYTES


class RecordingError(FleetPoseError):
    """A recording that cannot be written or read; the sentence says why."""


@dataclass(frozen=True)
class Record:
    """One message.

    Attributes:
        at_s: seconds after the recording's beginning.
        way: it came to who recorded it, was an answer to its query, or was sent by it; or a token
            came or went.
        at_ns: UTC, by the clock of who recorded it.
    """

    at_s: float
    way: Way
    sample: Sample
    at_ns: int = 0


class Recorder:
    """Writes messages into a file, in a thread of its own; use it in a `with`.

    Args:
        path: the file; it must not exist.
        site: name of the site.
        operator: name of the operator whose session it is; none where a whole site is recorded.
        library: who writes it.
        compressed: whether the file's chunks are; clouds and images are already.

    Attributes:
        left_out: messages that found no room on their way to the disk.
        failure: why the file ends before its time.
        written: messages that are in the file.
        cpu_s: of the writing thread.

    Raises:
        RecordingError: the file is there already, or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        site: str,
        operator: str = "",
        library: str = "",
        compressed: bool = True,
    ) -> None:
        self.left_out = self.written = 0
        self.failure: str | None = None
        self.cpu_s = 0.0
        self._path = path
        self._queue: Queue[tuple[int, Way, Sample]] = Queue(_WAITING)
        self._ended = threading.Event()
        self._waiting_bytes, self._counting = 0, threading.Lock()
        self._channels: dict[tuple[str, Way, bool], int] = {}
        self._start_ns = time.time_ns() - time.monotonic_ns()  # a clock that is set moves nothing
        try:
            self._file: IO[bytes] = path.open("xb")
        except FileExistsError as error:
            raise RecordingError(f"{path} is there already: name another file") from error
        except OSError as error:
            raise RecordingError(f"{path} cannot be written: {error.strerror}") from error
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=compression)
        self._writer.start(profile="fleetpose", library=library)
        self._writer.add_metadata(NAME, {"site": site, "operator": operator})
        self._thread = threading.Thread(name="record", target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Writes what waits and ends the file."""
        self._ended.set()
        self._thread.join()

    def report(self) -> str:
        """What became of the file, in a sentence."""
        if self.failure is not None:
            return self.failure
        missing = f"; {self.left_out} messages are missing, the disk was too slow"
        return f"recorded in {self._path}{missing if self.left_out else ''}"

    def note(self, way: Way, sample: Sample) -> None:
        """Records a message; returns at once."""
        at_ns = self._start_ns + time.monotonic_ns()
        if not self._makes_room(len(sample.payload)):
            return
        try:
            self._queue.put_nowait((at_ns, way, sample))
        except Full:
            self._release(len(sample.payload))
            self.left_out += 1

    def token(self, key: str, alive: bool) -> None:
        """Records that a token is there, or gone."""
        self.note("token", Sample(key, HERE if alive else GONE, ""))

    def _makes_room(self, size: int) -> bool:
        with self._counting:
            if self._waiting_bytes + size > _WAITING_BYTES:
                self.left_out += 1
                return False
            self._waiting_bytes += size
            return True

    def _release(self, size: int) -> None:
        with self._counting:
            self._waiting_bytes -= size

    def _run(self) -> None:
        try:
            try:
                self._write_all()
                self._writer.finish()
            finally:
                self._file.close()
        except OSError as error:  # a full disk ends the recording, not the session
            self.failure = f"{self._path} ends here: {error.strerror}"
            self._forget()
        self.cpu_s = time.thread_time()

    def _write_all(self) -> None:
        """Writes until told to end; what is older than a second has left this process."""
        ended = False
        while not ended:
            ended = self._ended.wait(_PAUSE_S)
            for at_ns, way, sample in self._waiting():
                self._write(at_ns, way, sample)
            self._writer.flush()
            self.cpu_s = time.thread_time()

    def _forget(self) -> None:
        """Takes what comes until the end and writes none of it."""
        ended = False
        while not ended:
            ended = self._ended.wait(_PAUSE_S)
            self.left_out += sum(1 for _ in self._waiting())

    def _waiting(self) -> Iterator[tuple[int, Way, Sample]]:
        """What waits now, and not what comes meanwhile, which may never end."""
        for _ in range(self._queue.qsize()):
            item = self._queue.get_nowait()
            self._release(len(item[2].payload))
            yield item

    def _write(self, at_ns: int, way: Way, sample: Sample) -> None:
        for attached, payload in ((True, sample.attachment), (False, sample.payload)):
            if payload is not None:
                channel = self._channel(sample, way, attached)
                self._writer.add_message(channel, at_ns, payload, at_ns)
        self.written += 1

    def _channel(self, sample: Sample, way: Way, attached: bool) -> int:
        topic = f"{sample.key}/attachment" if attached else sample.key
        encoding = "" if attached else sample.encoding
        name = (f"{topic} {encoding}", way, attached)
        if name not in self._channels:
            self._channels[name] = self._writer.register_channel(
                topic, encoding, schema_id=0, metadata={"way": way, "key": sample.key}
            )
        return self._channels[name]


class Recording:
    """A recording; a file that a killed process left ends where it was cut off.

    Attributes:
        site, operator: whose it is; no operator where a whole site was recorded.
        seconds: how long it is.
        messages: how many there are.
        cut_off: who wrote it did not end it.

    Raises:
        RecordingError: the file cannot be read, is damaged, or is no recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.site, self.operator = "", ""
        self._first_ns: int | None = None
        self.seconds, self.messages, self.cut_off = 0.0, 0, False
        for record in self._records():  # once to the end: how long it is, and whose
            match record:
                case Metadata(name=name, metadata=about) if name == NAME:
                    self.site, self.operator = about.get("site", ""), about.get("operator", "")
                case Message(log_time=at_ns):
                    self._first_ns = at_ns if self._first_ns is None else self._first_ns
                    self.seconds = (at_ns - self._first_ns) / 1e9
                    self.messages += 1
                case _:
                    pass
        if not self.site:
            raise RecordingError(
                f"{path} is no recording of 'pose-server record' or 'hmi-client record'"
            )

    def __iter__(self) -> Iterator[Record]:
        channels: dict[int, Channel] = {}
        attachment: bytes | None = None
        for record in self._records():
            match record:
                case Channel(id=id):
                    channels[id] = record
                case Message(channel_id=id, log_time=at_ns, data=data) if id in channels:
                    channel = channels[id]
                    key, way = channel.metadata.get("key", ""), channel.metadata.get("way")
                    if channel.topic != key:
                        attachment = data
                        continue
                    if way in WAYS:
                        at_s = (at_ns - (self._first_ns or at_ns)) / 1e9
                        sample = Sample(key, data, channel.message_encoding, attachment)
                        yield Record(at_s, way, sample, at_ns)
                    attachment = None
                case _:
                    pass

    def _records(self) -> Iterator[object]:
        try:
            with self.path.open("rb") as file:
                yield from self._read(file)
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be read: {error.strerror}") from error

    def _read(self, file: IO[bytes]) -> Iterator[object]:
        reader = StreamReader(file, validate_crcs=True, record_size_limit=_MAX_RECORD_BYTES)
        try:
            yield from reader.records
        except InvalidMagic:
            return  # no MCAP at all, which shows
        except (McapError, CRCValidationError, struct.error, ZstdError, ValueError) as error:
            if not file.read(1):  # nothing behind it: what came last was not written to its end
                self.cut_off = True
                return
            raise RecordingError(
                f"{self.path} is damaged {self.seconds:.1f} s after its beginning "
                f"({type(error).__name__}): copy it anew from where it was recorded"
            ) from error
