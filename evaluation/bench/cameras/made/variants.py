"""What a variant of a fault is."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.robot_agent.cameras.kinds import CameraKind


@dataclass(frozen=True)
class Variant:
    """A folder as somebody has it.

    Attributes:
        name: of it.
        kind: of the camera that opens it.
        write: writes it, and returns the true depth (H, W) of each of its frames, m.
        refused: what the refusal must say, a pattern; None where it must be opened right.
        frames: how many it has.
        options: of `open_camera`.
        source: of the folder, what is opened; empty: all of it.
    """

    name: str
    kind: CameraKind
    write: Callable[[Path], npt.NDArray[np.float32]]
    refused: str | None = None
    frames: int = 1
    options: dict[str, Any] = field(default_factory=dict)
    source: str = ""
