"""Names of the kinds of arrays, and the one error of this room."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


class FormatError(ValueError):
    """A file is missing, cut off, or says what cannot be; or what is to be written cannot be said
    in its format. The text names the file and what to do.
    """
