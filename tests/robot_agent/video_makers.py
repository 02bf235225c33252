"""Videos and a device for the tests of live stereo."""

import threading
import time

import cv2
import numpy as np

SIZE = WIDTH, HEIGHT = 64, 48
STEP = 3  # grey levels from one numbered image to the next


def numbered(number, size=SIZE):
    """An image that shows its number to `number_of`."""
    return np.full((size[1], size[0], 3), STEP * number, np.uint8)


def number_of(image):
    return round(float(image.mean()) / STEP)


def write_video(path, images, fps=30.0):
    """A lossless video."""
    height, width = images[0].shape[:2]
    code = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, fps, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(image)
    writer.release()
    return str(path)


class Device:
    """A device that takes numbered images by itself and queues four of them, as V4L2 does.

    Call it as `cv2.VideoCapture` would be; what it does can be changed while it runs.
    """

    def __init__(self, fps=100.0, offset_s=0.0, size=SIZE, began_s=None, stamps=True):
        self.stamps = stamps  # whether its driver stamps its images
        self.period_s, self.size = 1 / fps, size
        self.began_s = (time.monotonic() if began_s is None else began_s) + offset_s
        self.plugged = threading.Event()
        self.plugged.set()
        self.hangs = threading.Event()
        self.goes_on = threading.Event()
        self.opened = 0
        self.retrieved = 0

    def __call__(self, name, backend):
        self.opened += 1
        self._next = self._newest() + 1
        return self

    def _newest(self):
        return int((time.monotonic() - self.began_s) / self.period_s)

    def isOpened(self):
        return self.plugged.is_set()

    def get(self, what):
        if what == cv2.CAP_PROP_POS_MSEC and self.stamps:
            return 1e3 * (self.began_s + (self._next - 1) * self.period_s)
        sizes = {cv2.CAP_PROP_FRAME_WIDTH: self.size[0], cv2.CAP_PROP_FRAME_HEIGHT: self.size[1]}
        return float(sizes.get(what, 0))

    def set(self, what, value):
        return True

    def grab(self):
        if self.hangs.is_set():
            self.goes_on.wait(30)
        self._next = max(self._next, self._newest() - 3)  # the queue's oldest
        due_s = self.began_s + self._next * self.period_s
        self.goes_on.wait(max(due_s - time.monotonic(), 0))
        self._next += 1
        return self.plugged.is_set()

    def retrieve(self):
        self.retrieved += 1
        return True, numbered((self._next - 1) % 80, self.size)

    def release(self):
        pass

    def true_number(self):
        """The image that it takes now."""
        return self._newest() % 80
