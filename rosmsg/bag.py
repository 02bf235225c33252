"""Bags: ROS 1 (.bag), mcap, sqlite3, folders of a recorder, one file or several."""

import heapq
import logging
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import zstandard
from rosbags.rosbag1 import Reader as Rosbag1
from rosbags.rosbag2 import Reader as Rosbag2

from fleetpose.protocol.errors import CodecError, DataFolderError
from fleetpose.rosmsg import METADATA, SUFFIXES
from fleetpose.rosmsg.truncated import TruncatedMcap
from fleetpose.rosmsg.typestore import Kind, Types

log = logging.getLogger(__name__)

_ZSTD = b"\x28\xb5\x2f\xfd"  # no CDR message begins so: its first byte is 0
_LARGEST_BYTES = 1 << 28  # of one message, unpacked
_TOLD = 3  # damaged messages of a type, by a line each


class Recorded(NamedTuple):
    """A message as it lies in a bag: its topic, how to read it, when the recorder got it (UTC, ns),
    and its bytes.
    """

    topic: str
    kind: Kind
    received_ns: int
    raw: bytes


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, its type (`sensor_msgs/msg/Image`), and how many messages."""

    name: str
    type: str
    count: int


class Part(Protocol):
    """One file, or one folder of a recorder.

    Attributes:
        topics: their kinds by name.
        counts: messages by topic.
        span_ns: when the first and the last message came; None without any.
    """

    topics: dict[str, Kind]
    counts: dict[str, int]
    span_ns: tuple[int, int] | None

    def messages(self, names: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording and bytes of each message of these topics."""
        ...

    def close(self) -> None:
        """Closes its files."""
        ...


class Bag:
    """A bag that is open. One iteration over messages at a time; another one begins anew.

    Args:
        source: a file, a folder, or several with commas between.

    Attributes:
        name: for errors.
        topics: in the order of their names.
        span_ns: when the first and the last message came; None without any.
        unreadable: messages that could not be read, by type.

    Raises:
        DataFolderError: there is no bag, or it cannot be read.
    """

    def __init__(self, source: str) -> None:
        self.name = source
        self._types = Types()
        self._parts = _open_parts(source)
        self.unreadable: Counter[str] = Counter()
        kinds = {topic: kind for part in self._parts for topic, kind in part.topics.items()}
        counts = sum((Counter(part.counts) for part in self._parts), Counter[str]())
        self.topics = tuple(
            Topic(name, kind.name, counts[name]) for name, kind in sorted(kinds.items())
        )
        spans = [part.span_ns for part in self._parts if part.span_ns is not None]
        self.span_ns = (min(a for a, _ in spans), max(b for _, b in spans)) if spans else None

    def messages(self, names: Collection[str] | None = None) -> Iterator[Recorded]:
        """All messages of these topics, or of all, in the order in which they were recorded."""
        streams = [_stream(part, names) for part in self._parts]
        for _, message in heapq.merge(*streams, key=lambda item: item[0]):
            yield message

    def read(self, message: Recorded) -> Any | None:
        """The message with the fields that its type names; None if it cannot be read, which is
        counted and told.
        """
        try:
            return self._types.read(message.kind, message.raw)
        except CodecError as error:
            self.unreadable[message.kind.name] += 1
            if self.unreadable[message.kind.name] <= _TOLD:
                log.warning("%s %s: %s", self.name, message.topic, error)
            return None

    def first(self, topic: str) -> Any | None:
        """The first message of a topic that can be read, None without one."""
        for message in self.messages([topic]):
            if (read := self.read(message)) is not None:
                return read
        return None

    def close(self) -> None:
        """Closes its files."""
        for part in self._parts:
            part.close()


def _open_parts(source: str) -> list[Part]:
    paths = [Path(source)] if Path(source).exists() else [Path(p) for p in source.split(",") if p]
    if not paths:
        raise DataFolderError("give --data: a bag, a file (.mcap, .db3, .bag) or a folder")
    parts: list[Part] = []
    try:
        for path in paths:
            parts.extend(_parts_of(path))
    except Exception:
        for part in parts:
            part.close()
        raise
    return parts


def _parts_of(path: Path) -> list[Part]:
    if not path.exists():
        raise DataFolderError(f"{path} does not exist: give a bag's file or folder")
    if not path.is_dir():
        return [_file(path)]
    if (path / METADATA).is_file():
        try:
            return [RosbagPart(path)]
        except DataFolderError as error:
            log.warning("%s: its files are read one by one", error)
    files = sorted(_files_in(path))
    if not files:
        raise DataFolderError(f"{path} holds no bag: no {METADATA}, no .mcap, .db3 or .bag")
    return [_file(file) for file in files]


def _files_in(folder: Path) -> Iterator[Path]:
    return (file for file in folder.iterdir() if file.suffix in SUFFIXES)


def _file(path: Path) -> Part:
    if path.suffix not in SUFFIXES:
        raise DataFolderError(f"{path} is no bag: bags are .mcap, .db3, .bag, or a folder")
    try:
        return RosbagPart(path)
    except DataFolderError as error:
        if path.suffix != ".mcap":
            raise
        left = TruncatedMcap(path)
        log.warning(
            "%s: was the recorder killed? %d messages are left and are read",
            *(error, sum(left.counts.values())),
        )
        return left


class RosbagPart:
    """What `rosbags` can open.

    Raises:
        DataFolderError: it cannot.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._reader = Rosbag1(path) if path.suffix == ".bag" else Rosbag2(path)
            self._reader.open()
        except Exception as error:  # damage shows as whatever error its reader runs into
            why = str(error) or type(error).__name__
            if "reindex" in why:
                why = "it was cut off: run 'rosbag reindex' on it"
            raise DataFolderError(f"{path} cannot be opened ({why})") from error
        coding = "ros1" if path.suffix == ".bag" else "cdr"
        self.topics: dict[str, Kind] = {}
        self.counts: Counter[str] = Counter()
        for one in self._reader.connections:
            self.topics[one.topic] = Kind(one.msgtype, one.msgdef, coding)
            self.counts[one.topic] += one.msgcount
        self.span_ns: tuple[int, int] | None = None
        if self._reader.message_count:
            self.span_ns = self._reader.start_time, self._reader.end_time - 1

    def messages(self, names: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        wanted = [one for one in self._reader.connections if names is None or one.topic in names]
        if not wanted:
            return
        messages = self._reader.messages(wanted)
        while True:
            try:
                item = next(messages, None)
                if item is None:
                    return
                raw = _unpacked(bytes(item[2]))
            except Exception as error:  # damage shows as whatever error its reader runs into
                log.warning("%s is damaged: what follows is left out (%s)", self._path, error)
                return
            yield item[0].topic, item[1], raw

    def close(self) -> None:
        with suppress(Exception):  # nothing is lost with a file that was read
            self._reader.close()


def _unpacked(raw: bytes) -> bytes:
    """Files of a recorder that packs each message, opened without the metadata that says so."""
    if not raw.startswith(_ZSTD):
        return raw
    return zstandard.ZstdDecompressor().decompress(raw, max_output_size=_LARGEST_BYTES)


def _stream(part: Part, names: Collection[str] | None) -> Iterator[tuple[int, Recorded]]:
    for topic, received_ns, raw in part.messages(names):
        yield received_ns, Recorded(topic, part.topics[topic], received_ns, raw)
