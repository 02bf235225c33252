"""A running site, or a recording at its own pace, for whoever connects with Foxglove.

The server is Foxglove's own (extra `live`). It keeps the last of everything for those who come
later, and says which images somebody looks at: robots send no others.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from queue import Empty, Full, Queue
from typing import Any

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener
from mcap_protobuf.schema import build_file_descriptor_set

from fleetpose.pose_server.recording.foxglove_scene import FoxgloveScene, image_topic
from fleetpose.pose_server.recording.show import Counted, Show
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Record, Recording, RecordingError
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import Link

_WAITING = 1000
"""Messages that are heard and not shown yet; more are left out, so that a slow viewer costs no
memory."""
_LOOK_S = 0.5


class LiveSink(ServerListener):
    """Foxglove's server on this machine or for others.

    Args:
        host, port: where it listens; 0 is any free port.
        name: what viewers call it.
        looked_at: told of a topic when its first viewer comes and when its last one goes, from a
            thread of the server's.

    Raises:
        RecordingError: nothing can listen there.
    """

    def __init__(
        self, host: str, port: int, name: str, looked_at: Callable[[str, bool], None]
    ) -> None:
        self._looked_at = looked_at
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[str, dict[str, tuple[bytes, int]]] = {}  # by topic, by what it is about
        self._viewers: Counter[str] = Counter()
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name=name, host=host, port=port, server_listener=self, context=self._context
            )
        except Exception as error:  # the library's own kinds are not told in its documents
            raise RecordingError(f"{host}:{port} cannot be listened at: {error}") from error
        self.address = f"ws://{host}:{self._server.port}"

    def offer(self, topic: str, schema: type[Any]) -> None:
        if topic not in self._channels:
            described = schema.DESCRIPTOR
            self._channels[topic] = foxglove.Channel(
                topic,
                message_encoding="protobuf",
                schema=foxglove.Schema(
                    name=described.full_name,
                    encoding="protobuf",
                    data=build_file_descriptor_set(schema).SerializeToString(),
                ),
                context=self._context,
            )

    def put(self, topic: str, of: str, message: Any, at_ns: int) -> None:
        self.offer(topic, type(message))
        said = message.SerializeToString()
        self._last.setdefault(topic, {})[of] = (said, at_ns)
        self._channels[topic].log(said, log_time=at_ns)

    def close(self) -> None:
        self._server.stop()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Who comes late is told what was said last."""
        topic = channel.topic
        for said, at_ns in list(self._last.get(topic, {}).values()):
            self._channels[topic].log(said, log_time=at_ns)
        self._viewers[topic] += 1
        if self._viewers[topic] == 1:
            self._looked_at(topic, True)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self._viewers[channel.topic] -= 1
        if self._viewers[channel.topic] == 0:
            self._looked_at(channel.topic, False)


class Listening:
    """What a running site says, and the images of robots that somebody looks at.

    Args:
        link: to the site; closed by who opened it.
        keys: of the site.

    Attributes:
        left_out: messages that found no room.
    """

    def __init__(self, link: Link, keys: Keys) -> None:
        self._link, self._keys = link, keys
        self._heard: Queue[Sample] = Queue(_WAITING)
        self._images: dict[str, Any] = {}
        self.left_out = 0
        for key in (keys.camera("*"), keys.poses, keys.state):
            link.on_latched(key, self._store)
        self._clouds = link.subscribe_bulk(keys.cloud("*"), self._store)

    def look(self, robot: str, wanted: bool) -> None:
        """Asks a robot for its images, or no more."""
        if wanted and robot not in self._images:
            key = self._keys.image(robot)
            self._images[robot] = self._link.subscribe_bulk(key, self._store)
        elif not wanted and (images := self._images.pop(robot, None)) is not None:
            images.undeclare()

    def records(self, stop: threading.Event) -> Iterator[Record]:
        """What is heard, until told to stop."""
        while not stop.is_set():
            try:
                sample = self._heard.get(timeout=_LOOK_S)
            except Empty:
                continue
            yield Record(0.0, "in", sample, time.time_ns())

    def close(self) -> None:
        """Hears nothing more."""
        for robot in list(self._images):
            self.look(robot, False)
        self._clouds.undeclare()

    def _store(self, sample: Sample) -> None:
        try:
            self._heard.put_nowait(sample)
        except Full:
            self.left_out += 1


def show_site(
    link: Link, keys: Keys, host: str, port: int, stop: threading.Event, say: Callable[[str], None]
) -> Counted:
    """Shows a running site until told to stop.

    Args:
        say: told the address.

    Raises:
        RecordingError: nothing can listen at the address.
    """
    listening = Listening(link, keys)

    def looked_at(topic: str, wanted: bool) -> None:
        robot = topic.split("/")[2] if topic.startswith("/robot/") else ""
        if robot and topic == image_topic(robot):
            listening.look(robot, wanted)

    sink = LiveSink(host, port, f"fleetpose {keys.site}", looked_at)
    say(sink.address)
    try:
        return _shown(listening.records(stop), sink)
    finally:
        listening.close()
        sink.close()


def show_recording(
    recording: Recording, host: str, port: int, stop: threading.Event, say: Callable[[str], None]
) -> Counted:
    """Shows a recording at its own pace, as of now, and its end until told to stop.

    Raises:
        RecordingError: nothing can listen at the address.
    """
    sink = LiveSink(host, port, f"fleetpose {recording.site}", lambda *_: None)
    say(sink.address)
    try:
        count = _shown(_paced(recording, stop), sink)
        stop.wait()
        return count
    finally:
        sink.close()


def _shown(records: Iterator[Record], sink: LiveSink) -> Counted:
    shown = Show(FoxgloveScene(sink))
    for record in records:
        shown.take(record)
    return shown.count


def _paced(recording: Recording, stop: threading.Event) -> Iterator[Record]:
    began_s, began_ns = time.monotonic(), time.time_ns()
    for record in recording:
        if stop.wait(max(record.at_s - (time.monotonic() - began_s), 0.0)):
            return
        yield Record(record.at_s, record.way, record.sample, began_ns + round(1e9 * record.at_s))
