"""A recording in lines: what the operator looked at and did, and what the server said to it."""

from collections.abc import Iterator

from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import Alignment, FleetState, OperatorUpdate, Receipts, Selection
from fleetpose.protocol.recording.file import Record, Recording
from fleetpose.protocol.text import one_line


def timeline(recording: Recording) -> Iterator[str]:
    """The lines, each with its minutes and seconds."""
    tellers = {
        encoding_of(Selection): _Selections(),
        encoding_of(OperatorUpdate): _Updates(),
        encoding_of(Receipts): _Receipts(recording.operator),
        encoding_of(Alignment): _Verdicts(),
        encoding_of(FleetState): _Located(),
    }
    for record in recording:
        teller = tellers.get(record.sample.encoding)
        text = teller.told(record) if teller is not None else ""
        if text:
            minutes, seconds = divmod(record.at_s, 60.0)
            yield one_line(f"{minutes:3.0f}:{seconds:04.1f}  {text}")


class _Teller:
    """Makes lines of the messages of one kind."""

    def told(self, record: Record) -> str:
        try:
            return self.line(record)
        except FleetPoseError as error:
            return f"damaged: {error}"

    def line(self, record: Record) -> str:
        raise NotImplementedError


class _Selections(_Teller):
    _last = ""

    def line(self, record: Record) -> str:
        s = unpack(Selection, record.sample.payload)
        if record.way != "out" or s.i is None:
            return ""
        still = ", held still" if s.view_i is not None or s.view_j is not None else ""
        text = f"looks at {s.i} and {s.j}{still}"
        text, self._last = ("" if text == self._last else text), text
        return text


class _Updates(_Teller):
    def __init__(self) -> None:
        self._told: set[tuple[str, int]] = set()

    def line(self, record: Record) -> str:
        u = unpack(OperatorUpdate, record.sample.payload)
        if record.way != "out" or (u.session, u.n) in self._told:
            return ""
        self._told.add((u.session, u.n))
        number = f" {u.correspondence}" if u.correspondence is not None else ""
        pixels = (u.pixel_i, u.pixel_j)
        where = " - ".join(f"({p[0]:.0f}, {p[1]:.0f})" for p in pixels if p is not None)
        return f"{u.action}s{number} {u.i} {u.j} {where}  (update {u.n})"


class _Receipts(_Teller):
    def __init__(self, operator: str) -> None:
        self._operator = operator
        self._n: dict[str, int] = {}

    def line(self, record: Record) -> str:
        r = unpack(Receipts, record.sample.payload)
        before = self._n.get(r.session, 0)
        if r.operator != self._operator or r.n <= before:
            return ""
        self._n[r.session] = r.n
        refused = [f"{x.n} refused: {x.reason}" for x in r.rejections if x.n > before]
        return "; ".join((f"server: taken up to update {r.n}", *refused))


class _Verdicts(_Teller):
    def __init__(self) -> None:
        self._last: dict[tuple[str, str], str] = {}

    def line(self, record: Record) -> str:
        a = unpack(Alignment, record.sample.payload)
        pair = (a.view_i.robot, a.view_j.robot)
        before, self._last[pair] = self._last.get(pair), a.verdict
        return "" if before == a.verdict else f"server: {pair[0]} {pair[1]} {a.verdict}"


class _Located(_Teller):
    _last: tuple[int, int] | None = None

    def line(self, record: Record) -> str:
        fleet = unpack(FleetState, record.sample.payload)
        located = sum(1 for r in fleet.robots if r.pose is not None and r.pose.located)
        found, before = (located, len(fleet.robots)), self._last
        self._last = found
        return "" if found == before else f"server: {found[0]} of {found[1]} robots located"
