"""Pictures decoded, once for all who look at them."""

import threading
from collections import OrderedDict

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.jpeg import frame_of
from fleetpose.hmi_client.model.records import Picture
from fleetpose.protocol.messages import ViewName

Image = npt.NDArray[np.uint8]
_KEPT = 4


def decoded(picture: Picture, halved: bool = False) -> Image:
    """The picture as (H, W, 3) BGR, in the sensor's own orientation.

    Args:
        picture: a JPEG.
        halved: give one of half the width and height, in half the time.

    Raises:
        PictureError: it is no image that can be shown; nothing large was allocated for it.
    """
    frame = frame_of(picture.jpeg)
    size = cv2.IMREAD_REDUCED_COLOR_2 if halved else cv2.IMREAD_COLOR
    how = size | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), how)
    except cv2.error as error:
        raise PictureError("its pixels are damaged") from error
    step = 2 if halved else 1
    expected = (-(-frame.height // step), -(-frame.width // step))
    if image is None or image.shape[:2] != expected:
        raise PictureError("its pixels are damaged")
    return np.asarray(image, np.uint8)


def grey_of(picture: Picture) -> Image:
    """The picture as (H, W) brightness, one value per full-resolution pixel.

    Raises:
        PictureError: it is no image that can be shown.
    """
    grey = np.asarray(cv2.cvtColor(decoded(picture), cv2.COLOR_BGR2GRAY), np.uint8)
    if picture.scale == 1:
        return grey
    size = (grey.shape[1] * picture.scale, grey.shape[0] * picture.scale)
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR), np.uint8)


class GreyImages:
    """The last images that were asked for, by any thread."""

    def __init__(self) -> None:
        self._kept: OrderedDict[ViewName, Image] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, picture: Picture) -> Image:
        """`grey_of`, at once if it was asked before."""
        with self._lock:
            grey = self._kept.get(picture.view)
        if grey is None:
            grey = grey_of(picture)  # outside of the lock: a hand may wait for another image
        with self._lock:
            self._kept[picture.view] = grey
            self._kept.move_to_end(picture.view)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return grey
