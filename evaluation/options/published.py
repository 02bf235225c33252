"""What `pose-eval bench` is asked for."""

from dataclasses import dataclass
from pathlib import Path

from fleetpose.evaluation.options.building import told


@dataclass(frozen=True)
class BenchOptions:
    """A published benchmark in its own folders."""

    layout: str = told("euroc, kitti, tum, 7scenes or replica.", ...)
    data: Path = told("Folder that the benchmark was unpacked into.", ...)
    robots: str = told("Sequences, one for each robot, e.g. MH_01_easy,MH_02_easy.", ...)
    split: int = told("Cut each sequence into so many robots.", 1, min=1)
    every: int | None = told(
        "Robots send each so-manieth frame; if not told, about two a second.", min=1
    )
    frames: int | None = told("So many of these of each sequence, from its start.", min=1)
