"""What is left of an mcap file that was cut off, as when a recorder dies, or that has no index."""

import logging
from collections.abc import Collection, Iterator
from pathlib import Path

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from fleetpose.protocol.errors import DataFolderError
from fleetpose.rosmsg.typestore import Coding, Kind

log = logging.getLogger(__name__)

_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros1msg": MessageDefinitionFormat.MSG}
_FORMATS["ros2idl"] = MessageDefinitionFormat.IDL
_CODINGS: dict[str, Coding] = {"cdr": "cdr", "ros1": "ros1"}
_NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")


class TruncatedMcap:
    """Reads an mcap file from its beginning up to where it is damaged.

    Attributes:
        topics: names and kinds.
        counts: messages by topic.
        span_ns: when the first and the last one was recorded; None without any.

    Raises:
        DataFolderError: it is no mcap file, or nothing is left of it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.topics: dict[str, Kind] = {}
        self.counts: dict[str, int] = {}
        self.span_ns: tuple[int, int] | None = None
        for topic, at_ns, _ in self.messages():
            self.counts[topic] = self.counts.get(topic, 0) + 1
            first, last = self.span_ns or (at_ns, at_ns)
            self.span_ns = min(first, at_ns), max(last, at_ns)
        if not self.counts:
            raise DataFolderError(f"{path} is no mcap file, or nothing is left of it")

    def messages(self, names: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, when it was recorded, ns, and bytes of each message."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        with self._path.open("rb") as file:
            records = StreamReader(file).records
            while True:
                try:
                    record = next(records, None)
                except Exception:  # whatever damage does to its reader, it ends here
                    return
                if record is None:
                    return
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                    self.topics[record.topic] = _kind(record, schemas.get(record.schema_id))
                elif isinstance(record, Message) and record.channel_id in channels:
                    topic = channels[record.channel_id].topic
                    if names is None or topic in names:
                        yield topic, record.log_time, record.data

    def close(self) -> None:
        """Nothing is held open."""


def _kind(channel: Channel, schema: Schema | None) -> Kind:
    coding = _CODINGS.get(channel.message_encoding, "unknown")
    if schema is None:
        return Kind("unknown", _NO_DEFINITION, coding)
    form = _FORMATS.get(schema.encoding)
    name = schema.name
    if coding == "ros1" and "/msg/" not in name:
        name = name.replace("/", "/msg/", 1)
    if form is None:
        return Kind(name, _NO_DEFINITION, coding)
    return Kind(name, MessageDefinition(form, schema.data.decode("utf-8", "replace")), coding)
