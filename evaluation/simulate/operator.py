"""A simulated operator: clicks true correspondences with the noise of a human hand."""

import random
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats, inverse, transform
from fleetpose.evaluation.simulate.mistakes import mistaken, sight_of
from fleetpose.evaluation.system.observer import Observer, SeenView
from fleetpose.hmi_client.network.outbox import Outbox
from fleetpose.protocol import codec
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import OperatorUpdate, Receipts, Selection, View
from fleetpose.protocol.transport import Sample, wait_until

CLICK_SIGMA_PX = 1.5
LOOK_S = 0.25  # from seeing two images to the first click in them: a person needs longer
REPEAT_S = 1.0
ERRAND_POINTS = 200  # that two views have in common, for an errand to be worth while
FINISH_S = 10.0  # that a run waits for its last clicks
PICKS_LOOKED_AT = 60  # far apart, from which a wrong answer is made
Size = tuple[int, int]
_VISIBLE_TOLERANCE_M = 0.02
_VISIBLE_TOLERANCE_PER_Z = 0.02


@dataclass(frozen=True)
class Click:
    """One true correspondence as clicked, (2,) pixels each."""

    pixel_i: Floats
    pixel_j: Floats


class Eyes(Protocol):
    """Knows which pixels of two views show the same point; the truth behind the operator."""

    def correspondences(self, i: SeenView, j: SeenView) -> tuple[Floats, Floats]:
        """Pixels (N, 2) of view i and of view j that show the same N points; N may be 0."""
        ...


def by_tracks(
    ids_i: npt.NDArray[np.int64], uv_i: Floats, ids_j: npt.NDArray[np.int64], uv_j: Floats
) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of both views for the track ids that they share."""
    _, at_i, at_j = np.intersect1d(ids_i, ids_j, return_indices=True)
    return np.take(uv_i, at_i, axis=0), np.take(uv_j, at_j, axis=0)


def by_depth(
    points_i: Floats, uv_i: Floats, points_j: Floats, uv_j: Floats, K_j: Floats, T_j_i: Floats
) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of both views, by moving dense points of i into j at the true pose.

    A point counts if the point of j nearest to its pixel lies at the same depth, so that hidden
    points are left out.
    """
    from scipy.spatial import KDTree

    moved = transform(T_j_i, points_i)
    front = moved[:, 2] > 0
    moved, uv_i = moved[front], uv_i[front]
    projected = (moved @ K_j.T)[:, :2] / moved[:, 2:]
    distance_px, nearest = KDTree(uv_j).query(projected, distance_upper_bound=2.0)
    near = np.isfinite(distance_px)
    seen_z = points_j[np.asarray(nearest)[near], 2]
    tolerance = _VISIBLE_TOLERANCE_M + _VISIBLE_TOLERANCE_PER_Z * seen_z
    visible = np.abs(moved[near, 2] - seen_z) < tolerance
    return uv_i[near][visible], projected[near][visible]


def by_depth_images(
    uv_i: Floats, depth_i: Floats, depth_j: Floats, K_i: Floats, K_j: Floats, T_j_i: Floats
) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of both views, of those pixels of view i that view j sees at the true pose.

    Args:
        uv_i: (M, 2) pixels of view i.
        depth_i, depth_j: (H, W) metres, nan where there is none.
        K_i, K_j: (3, 3) px.
        T_j_i: (4, 4) true pose.
    """
    z = _at(depth_i, uv_i)
    rays = np.column_stack((uv_i, np.ones(len(uv_i)))) @ np.linalg.inv(K_i).T
    moved = transform(T_j_i, rays * z[:, None])
    front = moved[:, 2] > 0  # not where there is no depth
    moved, uv_i = moved[front], uv_i[front]
    uv_j = (moved @ K_j.T)[:, :2] / moved[:, 2:]
    seen_z = _at(depth_j, uv_j)
    tolerance = _VISIBLE_TOLERANCE_M + _VISIBLE_TOLERANCE_PER_Z * seen_z
    visible = np.abs(moved[:, 2] - seen_z) < tolerance
    return uv_i[visible], uv_j[visible]


def _at(depth: Floats, uv: Floats) -> Floats:
    """(N,) the depths at pixels (N, 2); nan outside."""
    columns, rows = np.rint(uv).astype(int).T
    height, width = depth.shape
    inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    z = np.full(len(uv), np.nan)
    z[inside] = depth[rows[inside], columns[inside]]
    return z


def by_view_depth(i: View, j: View, T_i_j: Floats, points: int = 4000) -> tuple[Floats, Floats]:
    """Like `by_depth`, from the clouds that two robots sent; of view i so many points are tried."""
    from fleetpose.protocol.clouds import points_of

    cloud_i, cloud_j = points_of(i), points_of(j)
    some = slice(None, None, max(len(cloud_i.uv) // points, 1))
    return by_depth(
        cloud_i.xyz[some], cloud_i.uv[some], cloud_j.xyz, cloud_j.uv, j.camera.K, inverse(T_i_j)
    )


def far_apart(uv: Floats, count: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Indices of `count` pixels far from each other, the first by chance."""
    chosen = [int(rng.integers(len(uv)))]
    distance = np.linalg.norm(uv - uv[chosen[0]], axis=1)
    while len(chosen) < min(count, len(uv)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(uv - uv[chosen[-1]], axis=1))
    return np.asarray(chosen)


def draw_clicks(
    pixels: tuple[Floats, Floats],
    count: int,
    rng: np.random.Generator,
    sizes: tuple[Size, Size],
    sigma_px: float = CLICK_SIGMA_PX,
) -> list[Click]:
    """Picks correspondences far apart and adds a hand's noise; clicks stay within the images.

    Args:
        pixels: (N, 2) of view i and of view j.
        count: how many at most.
        rng: of choice and noise.
        sizes: width and height of both images.
        sigma_px: of the noise, in each direction of each image.
    """
    if not len(pixels[0]):
        return []
    chosen = far_apart(pixels[0], count, rng)
    return by_hand((pixels[0][chosen], pixels[1][chosen]), rng, sizes, sigma_px)


def by_hand(
    pixels: tuple[Floats, Floats],
    rng: np.random.Generator,
    sizes: tuple[Size, Size],
    sigma_px: float = CLICK_SIGMA_PX,
) -> list[Click]:
    """Clicks on pixels (N, 2) of two views with a hand's noise; they stay within the images."""
    clicks = []
    for both in zip(*pixels, strict=True):
        noisy = [
            np.clip(uv + rng.normal(0.0, sigma_px, 2), 0.0, np.subtract(size, 1.0))
            for uv, size in zip(both, sizes, strict=True)
        ]
        clicks.append(Click(noisy[0], noisy[1]))
    return clicks


@dataclass
class Sent:
    """A click on its way: when it was put, was receipted, and led to a pose."""

    update: OperatorUpdate
    put_s: float
    receipted_s: float | None = None


class SimulatedOperator:
    """Answers the server's questions over the network, at a steady rate, in a thread of its own.

    Where nothing is asked it clicks in a pair of robots by chance, so that the way of a click is
    measured in any case. A click counts as through when, after its receipt, its pair was aligned
    and then a pose of one of its robots arrived, however long that takes.

    Args:
        observer: what is known of the fleet, and the session to use.
        eyes: the truth.
        clicks_per_minute: how fast it clicks.
        only_asked: click nothing that the server did not ask for.
        errands: click so many points on each of these pairs (i < j) and nothing else.
        mistakes: share of the questions that it answers wrongly, as people do.
    """

    def __init__(
        self,
        observer: Observer,
        eyes: Eyes,
        clicks_per_minute: float,
        only_asked: bool = False,
        seed: int = 0,
        errands: Mapping[tuple[str, ...], int] | None = None,
        mistakes: float = 0.0,
    ) -> None:
        self._observer, self._eyes = observer, eyes
        self._period_s = 60.0 / clicks_per_minute
        self._only_asked = only_asked
        self._errands = None if errands is None else Counter(dict(errands))
        self._rng = np.random.default_rng(seed)
        self._chance = random.Random(seed)
        self._mistakes = mistakes
        self._outbox = Outbox("op-simulated")
        link, keys = observer.link, observer.keys
        self._publisher = link.latched(keys.updates(self._outbox.operator), block=True, history=10)
        self._selection = link.latched(keys.selection(self._outbox.operator), block=True)
        self._receipts: tuple[float, Receipts] | None = None
        link.on_latched(keys.receipts(self._outbox.operator), self._note_receipts)
        self._in_flight: list[Sent] = []
        self._planned: list[tuple[SeenView, SeenView, Click]] = []
        self._stop = threading.Event()
        self._clicking = True
        self.clicks = 0
        self.wrong_clicks = 0
        self.answers: Counter[str] = Counter()  # right, or the kind of mistake
        self.rejected: list[str] = []
        self.click_to_pose_s: list[float] = []
        self._thread = threading.Thread(target=self._run, name="operator", daemon=True)

    def start(self) -> None:
        """Begins to click."""
        self._thread.start()

    def close(self) -> None:
        """Ends the thread."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def finish(self) -> None:
        """Clicks no more, and waits a while for the poses of what was clicked."""
        self._clicking = False
        wait_until(lambda: not self._in_flight, FINISH_S)

    def unanswered_s(self) -> list[float]:
        """How long the clicks have waited that have led to no pose."""
        now_s = time.monotonic()
        return [now_s - sent.put_s for sent in self._in_flight]

    def in_flight(self) -> list[Sent]:
        """Clicks that have not led to a pose yet."""
        return list(self._in_flight)

    def _note_receipts(self, sample: Sample) -> None:
        try:
            receipts = codec.unpack(Receipts, sample.payload, sample.encoding)
            self._receipts = time.monotonic(), receipts
        except CodecError as error:
            self.rejected.append(str(error))

    def _run(self) -> None:
        next_click_s = next_repeat_s = time.monotonic()
        while not self._stop.wait(0.005 if self._in_flight else 0.05):
            now_s = time.monotonic()
            self._settle()
            if now_s >= next_repeat_s:
                for ticket in self._outbox.open:
                    self._put(ticket.update)
                next_repeat_s = now_s + REPEAT_S
            if self._clicking and not self._planned and now_s >= next_click_s - LOOK_S:
                self._planned = self._plan()
                if self._planned:
                    self._look_at(*self._planned[-1][:2])
                    next_click_s = max(next_click_s, time.monotonic() + LOOK_S)
            if self._clicking and now_s >= next_click_s and self._click():
                next_click_s = max(next_click_s, now_s) + self._period_s

    def _click(self) -> bool:
        """Makes the next click; whether there was one to make."""
        if not self._planned:
            return False
        i, j, click = self._planned.pop()
        ticket = self._outbox.post(
            "add",
            (i.view.name.robot, j.view.name.robot),
            0,
            view_i=i.view.name,
            view_j=j.view.name,
            pixel_i=click.pixel_i,
            pixel_j=click.pixel_j,
        )
        self._in_flight.append(Sent(ticket.update, time.monotonic()))
        self._put(ticket.update)
        self.clicks += 1
        return True

    def _look_at(self, i: SeenView, j: SeenView) -> None:
        """Says which two views are on the screen, as operators' clients do."""
        outbox, (name_i, name_j) = self._outbox, (i.view.name, j.view.name)
        selection = Selection(
            operator=outbox.operator,
            session=outbox.session,
            i=name_i.robot,
            j=name_j.robot,
            view_i=name_i,
            view_j=name_j,
        )
        self._selection.put(codec.pack(selection), codec.encoding_of(Selection))

    def _plan(self) -> list[tuple[SeenView, SeenView, Click]]:
        """Three clicks for the first question that has an answer, or for a pair by chance."""
        for i, j in self._candidates():
            sizes = [(seen.view.camera.width, seen.view.camera.height) for seen in (i, j)]
            pair = (i.view.name.robot, j.view.name.robot)
            most = 3 if self._errands is None else self._errands[pair]
            seen = self._eyes.correspondences(i, j)
            if self._errands is not None and len(seen[0]) < ERRAND_POINTS:
                continue  # they will see more of the same
            clicks = self._answer(seen, j.view, most, (sizes[0], sizes[1]))
            if clicks:
                if self._errands is not None:
                    self._errands[pair] -= len(clicks)
                return [(i, j, click) for click in clicks]
        return []

    def _answer(
        self, true: tuple[Floats, Floats], j: View, count: int, sizes: tuple[Size, Size]
    ) -> list[Click]:
        """Clicks for a question; wrong ones in the share of mistakes, where one can be made."""
        if self._mistakes and len(true[0]) and self._rng.uniform() < self._mistakes:
            order = far_apart(true[0], PICKS_LOOKED_AT, self._rng)
            spoilt = mistaken((true[0][order], true[1][order]), sight_of(j), count, self._rng)
            if spoilt is not None:
                self.answers[spoilt.kind] += 1
                self.wrong_clicks += int(spoilt.wrong.sum())
                return by_hand(spoilt.pixels, self._rng, sizes)
        clicks = draw_clicks(true, count, self._rng, sizes)
        self.answers["right"] += bool(clicks)
        return clicks

    def _candidates(self) -> Sequence[tuple[SeenView, SeenView]]:
        state = self._observer.state
        if state is None:
            return []
        view = self._observer.view
        if self._errands is not None:
            open_pairs = [pair for pair, left in self._errands.items() if left > 0]
            newest = [tuple(map(self._observer.newest_view, pair)) for pair in open_pairs]
            return [(i, j) for i, j in newest if i is not None and j is not None]
        asked = [(view(q.view_i), view(q.view_j)) for q in state.questions]
        found = [(i, j) for i, j in asked if i is not None and j is not None]
        if found or self._only_asked:
            return found
        robots = [robot.robot for robot in state.robots]
        pairs = [ordered_pair(*self._chance.sample(robots, 2)) for _ in robots if len(robots) > 1]
        views = [(self._observer.newest_view(i), self._observer.newest_view(j)) for i, j in pairs]
        return [(i, j) for i, j in views if i is not None and j is not None]

    def _put(self, update: OperatorUpdate) -> None:
        self._publisher.put(codec.pack(update), codec.encoding_of(OperatorUpdate))

    def _settle(self) -> None:
        if self._receipts is not None:
            receipted_s, receipts = self._receipts
            for ticket in self._outbox.settle(receipts):
                self._finish(ticket.update, ticket.reason, receipted_s)
        done = [sent for sent in self._in_flight if self._through(sent)]
        self._in_flight = [sent for sent in self._in_flight if sent not in done]

    def _finish(self, update: OperatorUpdate, reason: str | None, receipted_s: float) -> None:
        if reason is not None:
            self.rejected.append(reason)
            if self._errands is not None:
                self._errands[update.i, update.j] += 1
            self._in_flight = [sent for sent in self._in_flight if sent.update.n != update.n]
        for sent in self._in_flight:
            if sent.update.n == update.n:
                sent.receipted_s = receipted_s

    def _through(self, sent: Sent) -> bool:
        """Notes the time from put to pose, once there is one."""
        if sent.receipted_s is None:
            return False
        pair = (sent.update.i, sent.update.j)
        aligned_s = self._observer.first_alignment_s(pair, sent.receipted_s)
        pose_s = None if aligned_s is None else self._observer.first_pose_s(pair, aligned_s)
        if pose_s is None:
            return False
        self.click_to_pose_s.append(pose_s - sent.put_s)
        return True
