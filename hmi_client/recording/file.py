"""A session's messages in an MCAP file: what came, what was answered and what was sent, each as it
was on the wire, at its time.

A topic is the key of the message, its encoding the one on the wire. What zenoh carries beside the
payload stands before it under `<key>/attachment`. Which way a message went is in its channel's
metadata; site and operator are in the file's.

Format: https://mcap.dev/spec
"""

import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from typing import IO, Literal

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from zstandard import ZstdError

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.protocol.messages.base import MAX_MESSAGE_BYTES
from fleetpose.protocol.transport import Sample

Way = Literal["in", "answer", "out"]
NAME = "fleetpose-session"
_CHUNK_BYTES = 1 << 18  # a killed client loses the last chunk
_WAITING = 2000  # samples on their way to the disk; more are left out and counted
_MAX_RECORD_BYTES = 4 * MAX_MESSAGE_BYTES


@dataclass(frozen=True)
class Record:
    """One message of a session, `at_s` seconds after its beginning."""

    at_s: float
    way: Way
    sample: Sample


class Recorder:
    """Writes a session into a file, in a thread of its own; use it in a `with`.

    Args:
        path: the file; it must not exist.
        site: name of the site.
        operator: name of the operator.

    Raises:
        OperatorError: the file is there already, or cannot be written.
    """

    def __init__(self, path: Path, site: str, operator: str) -> None:
        self.left_out = 0
        self.failure: str | None = None
        self._path = path
        self._queue: Queue[tuple[int, Way, Sample] | None] = Queue(_WAITING)
        self._channels: dict[tuple[str, Way, bool], int] = {}
        self._start_ns = time.time_ns() - time.monotonic_ns()  # a clock that is set moves nothing
        try:
            self._file: IO[bytes] = path.open("xb")
        except FileExistsError as error:
            raise OperatorError(f"{path} is there already: name another file") from error
        except OSError as error:
            raise OperatorError(f"{path} cannot be written: {error.strerror}") from error
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._writer.start(profile="fleetpose", library="hmi-client")
        self._writer.add_metadata(NAME, {"site": site, "operator": operator})
        self._thread = threading.Thread(name="hmi record", target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Writes what waits and ends the file."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def report(self) -> str:
        """What became of the file, in a sentence."""
        if self.failure is not None:
            return self.failure
        missing = f"; {self.left_out} messages are missing, the disk was too slow"
        return f"recorded in {self._path}{missing if self.left_out else ''}"

    def note(self, way: Way, sample: Sample) -> None:
        """Records a message; returns at once."""
        try:
            self._queue.put_nowait((self._start_ns + time.monotonic_ns(), way, sample))
        except Full:
            self.left_out += 1

    def _run(self) -> None:
        try:
            try:
                while (item := self._queue.get()) is not None:
                    self._write(*item)
                self._writer.finish()
            finally:
                self._file.close()
        except OSError as error:  # a full disk ends the recording, not the session
            self.failure = f"{self._path} ends here: {error.strerror}"
            self._forget()

    def _forget(self) -> None:
        """Takes what comes until the end and writes none of it."""
        while True:
            try:
                if self._queue.get(timeout=1.0) is None:
                    return
                self.left_out += 1
            except Empty:
                continue

    def _write(self, at_ns: int, way: Way, sample: Sample) -> None:
        for attached, payload in ((True, sample.attachment), (False, sample.payload)):
            if payload is not None:
                channel = self._channel(sample, way, attached)
                self._writer.add_message(channel, at_ns, payload, at_ns)

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
    """A recorded session; a file that a killed client left ends where it was cut off.

    Raises:
        OperatorError: the file cannot be read, or is no recording of a session.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.site, self.operator = "", ""
        self._first_ns: int | None = None
        self.seconds = 0.0
        for record in self._records():  # once to the end: how long it is, and whose
            match record:
                case Metadata(name=name, metadata=about) if name == NAME:
                    self.site, self.operator = about.get("site", ""), about.get("operator", "")
                case Message(log_time=at_ns):
                    self._first_ns = at_ns if self._first_ns is None else self._first_ns
                    self.seconds = (at_ns - self._first_ns) / 1e9
                case _:
                    pass
        if not self.site or not self.operator:
            raise OperatorError(f"{path} is no recording of 'hmi-client record'")

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
                    if way in ("in", "answer", "out"):
                        at_s = (at_ns - (self._first_ns or at_ns)) / 1e9
                        sample = Sample(key, data, channel.message_encoding, attachment)
                        yield Record(at_s, way, sample)
                    attachment = None
                case _:
                    pass

    def _records(self) -> Iterator[object]:
        try:
            with self._path.open("rb") as file:
                yield from StreamReader(file, record_size_limit=_MAX_RECORD_BYTES).records
        except OSError as error:
            raise OperatorError(f"{self._path} cannot be read: {error.strerror}") from error
        except (McapError, struct.error, ZstdError, UnicodeDecodeError):
            return  # no MCAP at all, which shows, or cut off
