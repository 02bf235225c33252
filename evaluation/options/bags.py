"""What `pose-eval bags` is asked for. Nothing heavy is imported."""

from dataclasses import dataclass
from pathlib import Path

from fleetpose.evaluation.options.building import told


@dataclass(frozen=True)
class BagsOptions:
    """Which bags robots play."""

    data: tuple[Path, ...] = told("A bag, or a folder of bags; repeatable.", ())
    frames: int = told("Of the synthetic scene that is written in every form.", 8, min=2)
    seconds: float = told("For which the poses of live robots are looked at.", 8.0, min=1)
    live: bool = told("Start live robots, or only read.", True, "--live/--no-live")
