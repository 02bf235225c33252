"""Whether a camera sees what it saw before, but for noise: then nothing is to be computed again."""

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Tiles = npt.NDArray[np.float64]

STILL_PX = 0.05  # a shift of any part of the image by more is a motion
_SURE = 3.0  # sigmas by which it must be more
_TILE_PX = 80
_MOST_NOISE = 6.0  # grey levels between two images; beyond, noise cannot be told from change
_UNEVEN = 4.0  # noise variance in one part of an image over that in another
_ROUNDING = 1.0  # grey levels squared


class StillImage:
    """One grey image (H, W) to which later ones are compared."""

    def __init__(self, image: Image) -> None:
        self._image = image.astype(np.float32)
        height, width = image.shape
        self._tiles = (-(-width // _TILE_PX), -(-height // _TILE_PX))
        self._du, self._dv = (
            np.asarray(cv2.Sobel(self._image, cv2.CV_32F, u, 1 - u, ksize=3, scale=1 / 8))
            for u in (1, 0)
        )
        self._uu, self._uv, self._vv = (
            self._mean(product)
            for product in (self._du * self._du, self._du * self._dv, self._dv * self._dv)
        )
        self._count = image.size / (self._tiles[0] * self._tiles[1])

    def shows(self, image: Image) -> bool:
        """Whether an image shows the same: in no tile has anything moved or changed by more than
        noise explains. A change of brightness as a whole is none.
        """
        if image.shape != self._image.shape:
            return False
        change = image.astype(np.float32) - self._image
        mean = self._mean(change)
        u, v = self._mean(change * self._du), self._mean(change * self._dv)
        # least squares of change = a - du * shift_u - dv * shift_v, tile by tile; what gradients
        # have in common with the mean is nothing that a decision rests on
        determinant = np.maximum(self._uu * self._vv - self._uv**2, 1e-9)
        shift_u = (self._vv * u - self._uv * v) / determinant
        shift_v = (self._uu * v - self._uv * u) / determinant
        noise = np.maximum(self._mean(change * change) - mean**2 - (shift_u * u + shift_v * v), 0.0)
        sigma2 = (noise + 1e-3) / self._count * (self._uu + self._vv) / determinant
        moved = np.hypot(shift_u, shift_v) - _SURE * np.sqrt(sigma2) > STILL_PX
        changed = noise > np.minimum(_UNEVEN * noise.min() + _ROUNDING, _MOST_NOISE**2)
        return not (moved.any() or changed.any())

    def _mean(self, values: npt.NDArray[np.floating]) -> Tiles:
        """Means per tile."""
        return cv2.resize(values, self._tiles, interpolation=cv2.INTER_AREA).astype(np.float64)
