"""A link that records what passes through it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fleetpose.protocol.recording.file import Recorder
from fleetpose.protocol.transport import Link, Publisher, Sample


@dataclass
class RecordedPublisher(Publisher):
    """A publisher whose samples are recorded as sent."""

    key: str
    recorder: Recorder

    def put(self, payload: bytes, encoding: str, attachment: bytes | None = None) -> None:
        self.recorder.note("out", Sample(self.key, payload, encoding, attachment))
        super().put(payload, encoding, attachment)


class RecordedLink(Link):
    """What a client receives, asks and sends goes into a recording as well."""

    def __init__(self, link: Link, recorder: Recorder) -> None:
        super().__init__(link.session, link._declared)
        self._recorder = recorder

    def latched(self, key: str, block: bool = False, history: int = 1) -> Publisher:
        publisher = super().latched(key, block, history)
        return RecordedPublisher(publisher._inner, key, self._recorder)

    def on_latched(self, key_expr: str, callback: Callable[[Sample], None]) -> None:
        super().on_latched(key_expr, self._noting(callback))

    def subscribe_bulk(self, key: str, store: Callable[[Sample], None]) -> Any:
        return super().subscribe_bulk(key, self._noting(store))

    def query(self, selector: str, timeout_s: float = 3.0, background: bool = False) -> Sample:
        answer = super().query(selector, timeout_s, background)
        self._recorder.note("answer", answer)
        return answer

    def _noting(self, callback: Callable[[Sample], None]) -> Callable[[Sample], None]:
        def note_and_call(sample: Sample) -> None:
            self._recorder.note("in", sample)
            callback(sample)

        return note_and_call
