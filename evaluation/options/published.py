"""What `pose-eval bench` is asked for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fleetpose.evaluation.options.building import told


@dataclass(frozen=True)
class BenchOptions:
    """A published benchmark in its own folders."""

    layout: str = told(
        "euroc, kitti, tum, 7scenes, replica; of bags s3e, kimera-multi, graco.", ...
    )
    data: Path = told("Folder that the benchmark was unpacked into.", ...)
    robots: str = told(
        "Sequences, one for each robot, e.g. MH_01_easy,MH_02_easy; if not told, DATA is one.", ""
    )
    split: int = told("Make so many robots of each sequence.", 1, min=1)
    in_turn: bool = told(
        "How: each has a part of the way and meets the next one at its end, or all go all of it, "
        "with frames in turn.",
        True,
        "--in-turn/--interleaved",
    )
    stamps: Literal["header", "receive"] = told(
        "Bags: whose time counts, of the drivers (header) or the recorder (receive).", "header"
    )
    calibration: Path | None = told(
        "Bags without CameraInfo (S3E, GrAco): a calibration of both eyes, or a folder with one "
        "called like each robot."
    )
    every: int | None = told(
        "Robots send each so-manieth frame; if not told, about two a second.", min=1
    )
    frames: int | None = told("So many of these of each sequence, from its start.", min=1)


@dataclass(frozen=True)
class FormatsOptions:
    """What `pose-eval formats` is asked for."""

    python: Path | None = told("Python of an environment that has evo and pycolmap.")
    bundle: Path | None = told("Bundler's example kermit: bundle.out, or a folder with it.")
    robots: int = told("In the synthetic town.", 2, min=2)
    frames: int = told("Of each.", 6, min=3)
