"""The last views of a robot with their images, for whoever asks later."""

import threading
from collections import deque

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import ImageHeader, KeptView, View
from fleetpose.protocol.transport import Answer
from fleetpose.robot_agent.features.affine_keypoints import wide_view

JPEG_QUALITY = 85
WIDE_KEPT = 8  # of the wide sets of salient points


def kept_view(
    view: View, image: npt.NDArray[np.uint8], jpeg_quality: int = JPEG_QUALITY
) -> KeptView:
    """A view with its image (H, W, 3) or (H, W)."""
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    header = ImageHeader(view=view.name, stamp_ns=view.stamp_ns)
    return KeptView(view=view, jpeg=jpeg.tobytes(), image=header)


class KeptViews:
    """The newest views, by number. Thread-safe: one thread keeps, another answers.

    Images are kept as JPEG: it takes 2 to 3 % of the time that finding salient points does, and 30
    frames of a megapixel camera are 5 MB instead of 90.
    """

    def __init__(self, epoch: str, capacity: int = 30) -> None:
        self._epoch = epoch
        self._lock = threading.Lock()
        self._views: deque[KeptView] = deque(maxlen=capacity)
        self._wide: deque[KeptView] = deque(maxlen=WIDE_KEPT)

    def keep(self, kept: KeptView) -> None:
        """Keeps a view; the oldest goes."""
        with self._lock:
            self._views.append(kept)

    def answer(self, parameters: dict[str, str]) -> Answer:
        """What `view?seq=;epoch=;salient=;image=` replies: the newest view without a number; with
        `salient=wide` its wide set of salient points; with `image=no` no image.
        """
        find = self.find_wide if parameters.get("salient") == "wide" else self.find
        found = find(parameters.get("seq"), parameters.get("epoch"))
        if isinstance(found, str):
            return Answer(error=found)
        if parameters.get("image") == "no":
            found = found.model_copy(update={"jpeg": None, "image": None})
        return Answer(pack(found), encoding_of(KeptView))

    def find_wide(self, seq: str | None, epoch: str | None) -> KeptView | str:
        """The same view with the wide set of salient points and without its image; made on demand,
        which takes up to a second or two, and kept for a while.
        """
        found = self.find(seq, epoch)
        if isinstance(found, str):
            return found
        for wide in list(self._wide):  # only the thread that answers comes here
            if wide.view.name == found.view.name:
                return wide
        try:
            wide = KeptView(view=wide_view(found))
        except CodecError as error:
            return str(error)
        self._wide.append(wide)
        return wide

    def find(self, seq: str | None, epoch: str | None) -> KeptView | str:
        """The view of that number (the newest without one), or why there is none."""
        with self._lock:
            views = list(self._views)
        if epoch is not None and epoch != self._epoch:
            return f"epoch {epoch[:12]} is over: this agent lives in {self._epoch}"
        if not views:
            return "no view yet"
        if seq is None:
            return views[-1]
        for view in views:
            if str(view.view.name.seq) == seq:
                return view
        first, last = views[0].view.name.seq, views[-1].view.name.seq
        return f"view {seq[:20]} is not kept: {len(views)} views from {first} to {last} are"
