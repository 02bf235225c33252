"""What the operator's session is made of: pictures, picks and the lines of the list."""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from fleetpose.protocol.messages import Correspondence, ViewName

Pair = tuple[str, str]
"""Two robots in the order of their names, as on the wire."""
PixelUV = tuple[float, float]
"""A pixel of the rectified full-resolution image; (0, 0) is the centre of the top-left pixel."""

EntryStatus = Literal["pending", "erasing", "accepted", "outlier", "unused", "rejected"]


@dataclass(frozen=True)
class Picture:
    """The JPEG of one view; `scale` is full-resolution pixels per JPEG pixel."""

    view: ViewName
    jpeg: bytes
    scale: int
    received_s: float


@dataclass(frozen=True)
class Pick:
    """The same point in two views, in the order of the robots' names."""

    view_i: ViewName
    view_j: ViewName
    pixel_i: PixelUV
    pixel_j: PixelUV

    @property
    def pair(self) -> Pair:
        return self.view_i.robot, self.view_j.robot

    @classmethod
    def of(cls, view_a: ViewName, pixel_a: PixelUV, view_b: ViewName, pixel_b: PixelUV) -> "Pick":
        """Makes a pick from two views in either order."""
        if view_a.robot < view_b.robot:
            return cls(view_a, view_b, pixel_a, pixel_b)
        return cls(view_b, view_a, pixel_b, pixel_a)

    @classmethod
    def made_by(cls, correspondence: Correspondence) -> "Pick":
        """The pick that a correspondence of the server's set came from."""
        c = correspondence
        u_i, v_i = (float(x) for x in c.pixel_i)
        u_j, v_j = (float(x) for x in c.pixel_j)
        return cls(c.view_i, c.view_j, (u_i, v_i), (u_j, v_j))


@dataclass(frozen=True)
class HalfPick:
    """The first half of a pick: side 0 is the image of robot i, side 1 that of robot j."""

    side: int
    view: ViewName
    pixel: PixelUV


@dataclass(frozen=True)
class Deed:
    """What was taken back or done again, in words, and in which pair."""

    pair: Pair | None
    text: str


@dataclass(frozen=True)
class Entry:
    """One line of the list of correspondences of a pair.

    Attributes:
        pick: the two views and pixels.
        status: `pending` and `erasing` wait for the server; `rejected` has its reason in `note`.
        id: the server's number, once it has one.
        residual_m: distance of the two points after alignment.
        residual_px: the same in image i.
        note: why it was rejected.
        by: the other operator who made it; empty for one's own.
    """

    pick: Pick
    status: EntryStatus
    id: int | None = None
    residual_m: float | None = None
    residual_px: float | None = None
    note: str = ""
    by: str = ""


def new_events(old: tuple[str, ...], new: tuple[str, ...]) -> tuple[str, ...]:
    """The events of a sliding list that the previous list did not hold."""
    for kept in range(min(len(old), len(new)), 0, -1):
        if old[-kept:] == new[:kept]:
            return new[kept:]
    return new


@lru_cache(4096)  # a fleet is sorted at each look at it
def natural(name: str) -> tuple[str | int, ...]:
    """Sorting key by which r2 comes before r10."""
    return tuple(int(part) if k % 2 else part for k, part in enumerate(re.split(r"(\d+)", name)))
