"""What `pose-eval web` is asked for. Nothing heavy is imported."""

from dataclasses import dataclass
from pathlib import Path

from fleetpose.evaluation.options.building import told
from fleetpose.evaluation.options.names import CloudKind
from fleetpose.evaluation.options.recorded import CLOUDS


@dataclass(frozen=True)
class WebOptions:
    """Which bars the page is held to."""

    bars: str = told("Numbers of bars with commas between them. [default: all]", "")
    robots: int = told("Robots in the fleet.", 72, min=2)
    images: int = told("Of bar 11; 36000 are an hour.", 36_000, min=40)
    data: Path | None = told("Of bar 13: a recording of posed views, picked by hand.")
    clouds: CloudKind | None = told(CLOUDS)
    quick: bool = told("Fewer repetitions of each.", False, "--quick")
