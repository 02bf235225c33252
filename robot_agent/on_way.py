"""What is on its way to the server, and how much of a view the link carries.

A put returns at once, however slow the link: what does not pass queues up, and poses of moments
long past come back. So a robot sends one view at a time. The server says when it has it, and from
how long that took follows how much the next one holds.
"""

from dataclasses import dataclass, field

MOST_WAIT_S = 4.0  # for the server's word on a view: the next one goes then anyway
OVERDUE_S = 2.0  # what is not confirmed by then says so of the link, without more of it
SLOW_S = 1.0  # a view that takes longer is too large for the link
_FAST_S = 0.4
_AIM_S = 0.8
_FAST_IN_A_ROW = 10  # until more is tried: a step up on a poor link costs a late view
_SLOW_IN_A_ROW = 2  # one late word may be a busy computer's
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.125)
_LEAST_POINTS = 200
_LEAST_QUALITY = 30
_PART_OF_IMAGES = 0.15  # of a slow link's time: TLS buffers 64 kB of them, which delay a view
_LEAST_S = 1e-3
_WORTHWHILE = 0.2  # of a view that salient points must be, for fewer of them to help


@dataclass
class Budget:
    """How much of its salient points and of its images' quality a robot sends.

    Attributes:
        step: in `SHARES`.
    """

    step: int = 0
    _slow: int = 0
    _fast: int = 0

    @property
    def share(self) -> float:
        """Of the salient points, 0 to 1."""
        return SHARES[self.step]

    def points(self, most: int) -> int:
        """How many salient points a view holds, of `most` where the link is fast."""
        return max(min(_LEAST_POINTS, most), round(self.share * most))

    def quality(self, best: int) -> int:
        """The quality of JPEGs, of `best` where the link is fast."""
        least = min(_LEAST_QUALITY, best)
        return round(least + self.share * (best - least))

    def note(self, took_s: float, salient_part: float) -> bool:
        """Takes what a view took on its way; whether the share changed.

        Args:
            took_s: from the put to the server's word, without what the server took.
            salient_part: share of the view's bytes that its salient points are.
        """
        before = self.step
        sure = took_s >= OVERDUE_S
        self._slow = self._slow + (_SLOW_IN_A_ROW if sure else 1) if took_s > SLOW_S else 0
        self._fast = self._fast + 1 if took_s < _FAST_S else 0
        if self._slow >= _SLOW_IN_A_ROW and salient_part > _WORTHWHILE:
            wanted = self.share * max(_AIM_S / took_s, 0.4)
            small = (k for k, share in enumerate(SHARES) if share <= wanted)
            self.step, self._slow = next(small, len(SHARES) - 1), 0
        elif self._fast >= _FAST_IN_A_ROW and self.step:
            self.step, self._fast = self.step - 1, 0
        return self.step != before


@dataclass
class OnWay:
    """The view that the server has not confirmed yet, and when it confirmed one last. All times are
    of one monotonic clock.

    Attributes:
        took_s: what the last view took that was confirmed, or given up.
        confirmed_s: when the server said last that it has the newest view, or a newer one than
            before; None before.
        silent_since_s: when the first view was sent of those that are not confirmed; None without.
        waits: whether the server is one that confirms.
    """

    took_s: float = 0.0
    confirmed_s: float | None = None
    silent_since_s: float | None = None
    waits: bool = False
    budget: Budget = field(default_factory=Budget)
    _open: tuple[int, float, int, float] | None = None  # number, when sent, bytes, salient part
    _bytes_per_s: float | None = None  # that the link carried last
    _image_from_s: float = 0.0
    _overdue: bool = False  # the open view, and that was noted
    _newest_sent: int = -1
    _newest_confirmed: int = -1

    def sent(self, seq: int, now_s: float, size: int, salient_part: float) -> None:
        """A view of some bytes has been put."""
        self.note_overdue(now_s)
        if self._open is not None:
            self.took_s = now_s - self._open[1]
        self._open, self._newest_sent = (seq, now_s, size, salient_part), seq
        self._overdue = False
        if self.silent_since_s is None:
            self.silent_since_s = now_s

    def confirmed(self, seq: int, waited_s: float, now_s: float) -> bool:
        """The server has a view, which lay there for some time until it said so; whether the
        budget changed.
        """
        if seq >= self._newest_sent:
            self.silent_since_s = None
        elif seq > self._newest_confirmed:
            self.silent_since_s = now_s
        if seq > self._newest_confirmed or seq >= self._newest_sent:
            self.confirmed_s = now_s
        self._newest_confirmed = max(seq, self._newest_confirmed)
        if self._open is None or seq < self._open[0]:
            return False
        changed = self._note(max(now_s - self._open[1] - waited_s, 0.0))
        self._open = None
        return changed

    def note_overdue(self, now_s: float) -> None:
        """Has the next view shrink where this one does not come through: on a poor link none may
        ever, in time.
        """
        if self._open is None or not self.waits or self._overdue:
            return
        if now_s - self._open[1] >= OVERDUE_S:
            self._overdue = True
            self._note(now_s - self._open[1])

    def expected_free_in_s(self, now_s: float) -> float:
        """The same, if this view takes as long as the last one did."""
        if self._open is None or not self.waits:
            return 0.0
        return max(self._open[1] + min(self.took_s, MOST_WAIT_S) - now_s, 0.0)

    def image_may_go(self, size: int, now_s: float) -> bool:
        """Whether an image of some bytes may go now: on a slow link, images get a part of the time
        and views the rest.
        """
        if self.took_s < _FAST_S:
            return True
        if now_s < self._image_from_s:
            return False
        self._image_from_s = now_s + self.takes_s(size) / _PART_OF_IMAGES
        return True

    def takes_s(self, size: int) -> float:
        """How long so many bytes take at the pace of the last view; 0 where it is not known."""
        return 0.0 if self._bytes_per_s is None else size / self._bytes_per_s

    def _note(self, took_s: float) -> bool:
        """Notes what the open view took, at least; whether the budget changed."""
        assert self._open is not None
        _, _, size, salient_part = self._open
        self.took_s = took_s
        self._bytes_per_s = size / max(took_s, _LEAST_S)
        return self.budget.note(took_s, salient_part)

    def free_in_s(self, now_s: float) -> float:
        """In how long the next view may go; 0: now."""
        if self._open is None or not self.waits:
            return 0.0
        return max(self._open[1] + MOST_WAIT_S - now_s, 0.0)
