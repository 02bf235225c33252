"""Options that several commands have in common."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class CloudsOption(StrEnum):
    """Kinds of clouds of a posed-views folder."""

    sparse = "sparse"
    sparse_noisy = "sparse_noisy"
    stereo_pair_sparse = "stereo_pair_sparse"
    stereo_dense = "stereo_dense"


class WorldOption(StrEnum):
    """Plans of the synthetic world that fool."""

    colonnade = "colonnade"
    corridor = "corridor"
    courtyard2 = "courtyard2"
    courtyard4 = "courtyard4"
    facade = "facade"
    halls = "halls"
    halls_apart = "halls_apart"
    mirror = "mirror"
    weak = "weak"


Data = Annotated[Path, typer.Option(help="Posed-views or RGB-D folder with ground truth.")]
Clouds = Annotated[
    CloudsOption | None,
    typer.Option(help="Clouds of a posed-views folder; sparse_noisy if not told."),
]
Out = Annotated[Path, typer.Option(help="Folder for the results; it is made.")]
World = Annotated[
    WorldOption | None,
    typer.Option(help="A place of alike parts that fools, instead of the town square."),
]
Unique = Annotated[
    int, typer.Option(min=0, help="Things in it that are like no other: posters, carts, statues.")
]
Mistakes = Annotated[
    float,
    typer.Option(min=0, max=1, help="Share of questions answered wrongly, as people do."),
]
