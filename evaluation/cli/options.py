"""Options that several commands have in common."""

from collections.abc import Mapping, Sequence
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


Data = Annotated[
    Path,
    typer.Option(help="Posed-views or RGB-D folder with ground truth, or a reconstruction."),
]
MetresPerUnit = Annotated[
    float | None,
    typer.Option(help="Scale of a reconstruction (COLMAP, Bundler, VisualSfM). [default: 1]"),
]
Clouds = Annotated[
    CloudsOption | None,
    typer.Option(help="Clouds of a posed-views folder; else the only ones, or sparse_noisy."),
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


def numbers(option: str, text: str, count: int | None = None) -> list[int]:
    """Whole numbers with commas between them.

    Raises:
        FleetPoseError: it is something else, or another count.
    """
    from fleetpose.protocol.errors import FleetPoseError

    try:
        found = [int(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or (count is not None and len(found) != count):
        raise FleetPoseError(f"{option} {text!r}: write numbers like 0,3 or 40,90")
    return found


def only_one(option: str, given: Sequence[Path] | None) -> Path | None:
    """The value of an option that may be repeated elsewhere; none if it is not given.

    Raises:
        FleetPoseError: it is given more than once.
    """
    from fleetpose.protocol.errors import FleetPoseError

    if given and len(given) > 1:
        raise FleetPoseError(f"{option} {given[1]}: give one here, several only with --offline")
    return given[0] if given else None


def refuse_offline(live_only: Mapping[str, bool]) -> None:
    """Refuses options of live fleets beside --offline, rather than leaving them out unsaid.

    Args:
        live_only: such options, and whether they were given.

    Raises:
        FleetPoseError: one was.
    """
    from fleetpose.protocol.errors import FleetPoseError

    given = [option for option, is_given in live_only.items() if is_given]
    if given:
        raise FleetPoseError(f"{' and '.join(given)}: of live fleets only, leave --offline out")
