"""Keyframes by their looks."""

from collections.abc import Container

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.retrieval.hamming_index import INDEX, NOBODY, HammingIndex
from fleetpose.protocol.messages import ViewName

_SPARE = 1000  # keyframes that are none any more, before their places are used again


class ViewIndex:
    """The keyframes that were ever laid beside others. Those of robots with images and of robots
    without have descriptors of other lengths, and are never alike.
    """

    def __init__(self) -> None:
        self._of_length: dict[int, _Alike] = {}

    def add(self, view: ViewName, descriptors: npt.NDArray[np.uint8]) -> None:
        """Adds a keyframe with its strongest descriptors (N, D)."""
        self._alike(descriptors).add(view, _unit(descriptors))

    def most_alike(self, descriptors: npt.NDArray[np.uint8]) -> list[ViewName]:
        """The keyframes that have anything in common with descriptors (N, D), the likest first."""
        return self._alike(descriptors).most_alike(_unit(descriptors))

    def forget_others(self, keyframes: Container[ViewName], count: int) -> None:
        """Drops what is none of so many keyframes, once that is worth it."""
        for alike in self._of_length.values():
            if len(alike.views) > 2 * count + _SPARE:
                alike.forget_others(keyframes)

    def _alike(self, descriptors: npt.NDArray[np.uint8]) -> "_Alike":
        return self._of_length.setdefault(descriptors.shape[1], _Alike())


class _Alike:
    """Keyframes whose descriptors are of one length. Until there are enough to make an index of,
    all of them may be alike.
    """

    def __init__(self) -> None:
        self.views: list[ViewName] = []
        self._index: HammingIndex | None = None
        self._first: list[npt.NDArray[np.float32]] = []

    def add(self, view: ViewName, descriptors: npt.NDArray[np.float32]) -> None:
        self.views.append(view)
        if self._index is not None:
            self._index.add(descriptors, len(self.views) - 1)
            return
        self._first.append(descriptors)
        if sum(map(len, self._first)) >= INDEX.taught_by:
            self._index = HammingIndex(np.concatenate(self._first))
            for owner, one in enumerate(self._first):
                self._index.add(one, owner)
            self._first.clear()

    def most_alike(self, descriptors: npt.NDArray[np.float32]) -> list[ViewName]:
        if self._index is None:
            return list(self.views)
        votes = self._index.votes(descriptors, len(self.views))
        return [self.views[n] for n in np.argsort(-votes, kind="stable") if votes[n] > 0]

    def forget_others(self, keyframes: Container[ViewName]) -> None:
        if self._index is None:
            return
        stays = np.array([view in keyframes for view in self.views])
        self._index.renumber(np.where(stays, np.cumsum(stays) - 1, NOBODY).astype(np.int32))
        self.views = [view for view, kept in zip(self.views, stays, strict=True) if kept]


def _unit(descriptors: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    vectors = descriptors.astype(np.float32)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)
