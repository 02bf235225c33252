"""Where image and loupe stand in a panel, and what part of the image is shown."""

from dataclasses import dataclass

from fleetpose.hmi_client.model.records import PixelUV
from fleetpose.hmi_client.tui.drawing.cells import Window

MIN_LOUPE = (11, 5)  # columns, rows; below that it shows too little to aim by
MAX_LOUPE = (33, 17)


@dataclass(frozen=True)
class Arrangement:
    """Where image and loupe stand in a panel, in cells; the image begins at the top left."""

    columns: int
    rows: int
    loupe: tuple[int, int, int, int] | None
    """Column, row, columns, rows."""


def arrange(columns: int, rows: int, aspect: float) -> Arrangement:
    """Puts the loupe under or beside the image, where it costs the image less.

    Args:
        columns, rows: of the panel.
        aspect: width / height of the image.
    """
    beside = min(max(columns - 1 - round(2 * rows * aspect), MIN_LOUPE[0]), MAX_LOUPE[0])
    under = min(max(rows - round(columns / aspect / 2), MIN_LOUPE[1]), MAX_LOUPE[1])
    left, top = columns - 1 - beside, rows - under
    if min(left, 2 * rows * aspect) >= min(columns, 2 * top * aspect) and left >= MIN_LOUPE[0]:
        return Arrangement(left, rows, (left + 1, 0, beside, rows))
    if top >= MIN_LOUPE[1]:
        return Arrangement(columns, top, (0, top, columns, under))
    return Arrangement(columns, rows, None)


def fit(
    arrangement: Arrangement, size: tuple[float, float], zoom: float, centre: PixelUV
) -> Window:
    """What is shown of an image (width, height in px): around the centre, not beyond it."""
    columns, rows = arrangement.columns, arrangement.rows
    px = max(size[0] / columns, size[1] / (2 * rows)) / zoom
    extents = (columns * px, 2 * rows * px)
    corner = [
        (full - extent) / 2
        if extent >= full
        else min(max(middle + 0.5 - extent / 2, 0.0), full - extent)
        for full, extent, middle in zip(size, extents, centre, strict=True)
    ]
    return Window(corner[0], corner[1], px, columns, rows)
