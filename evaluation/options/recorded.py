"""What commands are asked for that work on recordings. Nothing heavy is imported here."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from fleetpose.evaluation.options.building import Text, numbers, told
from fleetpose.evaluation.options.names import CloudKind, RecipeOption

if TYPE_CHECKING:
    from fleetpose.evaluation.data.recording import Recording


Out = Annotated[Path, Option(help="Folder for the results; it is made.")]
CLOUDS = "Clouds of a posed-views folder; else the only ones, or sparse_noisy."
SCALE = "Scale of a reconstruction (COLMAP, Bundler, VisualSfM). [default: 1]"


def _from_to(option: str, text: str) -> tuple[int, int]:
    """One whole number, or two with dots between them."""
    from fleetpose.protocol.errors import FleetPoseError

    first, dots, last = text.partition("..")
    (low,) = numbers(option, first, 1)
    (high,) = numbers(option, last, 1) if dots else (low,)
    if not 0 <= low <= high:
        raise FleetPoseError(f"{option} {text!r}: write a number like 3, or from..to like 3..6")
    return low, high


@dataclass(frozen=True)
class PosedOptions:
    """A recording with ground truth."""

    data: Path = told("Posed-views or RGB-D folder with ground truth, or a reconstruction.", ...)
    clouds: CloudKind | None = told(CLOUDS)


@dataclass(frozen=True)
class RecordedOptions(PosedOptions):
    """The same, or a reconstruction whose scale is told."""

    metres_per_unit: float | None = told(SCALE)

    def recording(self) -> "Recording":
        """Opens it.

        Raises:
            DataFolderError: it cannot be used.
        """
        from fleetpose.evaluation.data.opening import open_recording
        from fleetpose.evaluation.data.reconstructed import in_metres

        return open_recording(in_metres(self.data, self.metres_per_unit), self.clouds)


@dataclass(frozen=True)
class PairsOptions(RecordedOptions):
    """What `pose-eval pairs` is asked for."""

    workers: int = told("Processes.", 2, min=1)
    limit: int | None = told("So many pairs, spread evenly.", min=1)
    mirror_share: float = told("Share of the cameras that flip their images.", 0.0, min=0, max=1)
    images: bool = told("Robots have images, or clouds alone.", True, "--images/--without-images")


@dataclass(frozen=True)
class AblateOptions(RecordedOptions):
    """What `pose-eval ablate` is asked for."""

    by: float = told("Share by which each number is changed, less and more.", 0.2, min=0, max=1)
    limit: int | None = told("So many pairs, spread evenly.", 40, min=1)
    workers: int = told("Processes.", 2, min=1)


@dataclass(frozen=True)
class AlignOptions(RecordedOptions):
    """What `pose-eval align` is asked for."""

    workers: int = told("Pairs at a time; more than one spoils the times.", 1, min=1)
    limit: int | None = told("So many pairs, spread evenly.", min=1)
    min_overlap: float = told("RGB-D: pairs that overlap less are left out.", 0.3, min=0, max=1)
    images: bool = told("Robots have images, or clouds alone.", True, "--images/--without-images")


@dataclass(frozen=True)
class ClusterOptions(RecordedOptions):
    """What `pose-eval cluster` is asked for."""

    workers: tuple[int, ...] = told("Numbers of Dask workers.", (1, 2, 4), text=Text(numbers))
    limit: int = told("So many pairs, spread evenly.", 120, min=2)


@dataclass(frozen=True)
class RingOptions(RecordedOptions):
    """What `pose-eval ring` is asked for."""

    recipe: RecipeOption = told(
        "paper: its method alone; full: the server's; both: side by side.", "full"
    )
    wrong_share: float = told(
        "Share of the clicks that are 50 px off.", 0.0, "--wrong-clicks", min=0, max=1
    )
    draws: int = told("Of clicks, per pair.", 20, min=1)
    clicks: tuple[int, ...] = told(
        "Numbers of clicks per pair.", (0, 1, 2, 3, 4, 5), text=Text(numbers)
    )
    starts: int = told("Rings per separation, at most, each begun elsewhere.", 1, min=1)
    workers: int = told("Processes.", 2, min=1)
    seed: int = told("Of the clicks.", 0)

    def draws_of(self, clicks: int) -> int:
        """Draws of so many clicks: of none there is only one."""
        return self.draws if clicks else 1


@dataclass(frozen=True)
class MapOptions(PosedOptions):
    """What `pose-eval map` is asked for. Of a depth camera's walk the first frames of as many equal
    stretches are taken.
    """

    robots: int = told("On consecutive views.", 8, min=2)
    first: int = told("Posed views: the first of them.", 0, min=0)
    voxel_m: float | None = told(
        "Edge of the map's voxels, metres. [default: what suits the cameras]"
    )
    workers: int = told("Processes that make the views.", 2, min=1)


@dataclass(frozen=True)
class ClicksOptions(RecordedOptions):
    """What `pose-eval clicks` is asked for. `clicks`: from and to how many."""

    clicks: tuple[int, int] = told(
        "Per pair; with --consistent-wrong also from..to, e.g. 3..6.",
        (3, 3),
        text=Text(_from_to, lambda given: "..".join(str(one) for one in sorted(set(given)))),
    )
    wrong: int = told("So many of them are 50 px off.", 0, min=0)
    consistent_wrong_m: float = told(
        "All are so far along the surface off instead.",
        0.0,
        "--consistent-wrong",
        min=0,
        metavar="METRES",
    )
    permuted: bool = told("Click four points of a plane in every wrong order.", False, "--permuted")
    automatic: bool = told(
        "With these two: the server aligns the pair first.", False, "--automatic"
    )
    angles_deg: tuple[float, float] = told(
        "Between optical axes, degrees.", (40, 90), "--angles", text=Text(partial(numbers, count=2))
    )
    min_shared: int = told("Points that both views see.", 30, min=0)
    draws: int = told("Of clicks, per pair.", 20, min=1)
    limit: int | None = told("So many pairs, spread evenly.", min=1)
    workers: int = told("Processes.", 2, min=1)
    seed: int = told("Of the clicks.", 0)

    def __post_init__(self) -> None:
        """Raises a FleetPoseError if more clicks were to be wrong than there are, or from..to is
        asked for where it means nothing."""
        from fleetpose.protocol.errors import FleetPoseError

        count, most = self.clicks
        if count < most and not self.consistent_wrong_m:
            raise FleetPoseError(f"--clicks {count}..{most}: from..to goes with --consistent-wrong")
        if self.wrong > count:
            raise FleetPoseError(f"--wrong {self.wrong}: of {count} clicks at most all are")


@dataclass(frozen=True)
class PersistOptions:
    """What `pose-eval persist` is asked for. Half of the runs are walked back."""

    data: Path | None = told("RGB-D folder with ground truth; else the synthetic world.")
    views: int = told("Followed after the clicks.", 20, min=1)
    clicks: int = told("In the first views of a run.", 3, min=3)
    runs: int = told("At most, begun at different views.", 10, min=1)
    separation_deg: float = told(
        "Of the robots in the synthetic world, degrees.", 45.0, "--separation", min=1, max=180
    )
    workers: int = told("Processes.", 2, min=1)
    seed: int = told("Of clicks and of the world.", 0)


@dataclass(frozen=True)
class QuestionsOptions(RecordedOptions):
    """What `pose-eval questions` is asked for."""

    seeds: int = told("Fleets, each drawn by a seed.", 20, min=1)
    first: int = told("The first seed.", 0, min=0)
    workers: int = told("Processes.", 2, min=1)
    mistakes: float = told("Share of questions answered wrongly, as people do.", 0.0, min=0, max=1)


@dataclass(frozen=True)
class WireOptions(RecordedOptions):
    """What `pose-eval wire` is asked for."""

    views: int = told("So many, spread evenly.", 10, min=1)


@dataclass(frozen=True)
class SolveOptions:
    """What `pose-eval solve` is asked for."""

    robots: int = told("How many.", 72, min=2)
    edges: int = told("Alignments between them.", 400, min=1)
    wrong: float = told("Share that is wrong.", 0.3, min=0, max=0.9)
    seed: int = told("Of the fleet.", 0)
    g2o: Path | None = told("A recorded pose graph instead: a file, or a folder.")
