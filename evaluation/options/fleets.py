"""What commands are asked for that run fleets, worlds or terminals. Nothing heavy is imported."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self, get_args

from fleetpose.evaluation.options.building import Text, numbers, told
from fleetpose.evaluation.options.names import CloudKind, PlanName
from fleetpose.evaluation.options.recorded import CLOUDS, SCALE

if TYPE_CHECKING:
    from fleetpose.evaluation.data.recording import Recording


def _columns_and_rows(option: str, text: str) -> tuple[int, int]:
    from fleetpose.hmi_client.cli.commands import size_of

    del option
    return size_of(text)


_FOOLS = (
    "A place of alike parts that fools, instead of the town square: "
    f"{', '.join(get_args(PlanName))}."
)
_UNIQUE = "Things in it that are like no other: posters, carts, statues."
_SIZE = Text(_columns_and_rows, lambda size: f"{size[0]}x{size[1]}")


@dataclass(frozen=True)
class SynthOptions:
    """What `pose-eval synth` is asked for. Without a plan it is the town square with a ring."""

    robots: int = told("On the ring 8 to 72: neighbours are 360/N deg apart.", ..., min=2)
    seed: int = told("Of textures, places and noise.", 0)
    workers: int = told("Processes.", 2, min=1)
    plan: PlanName | None = told(_FOOLS, None, "--world", metavar="PLACE")
    unique: int = told(_UNIQUE, 0, min=0)


@dataclass(frozen=True)
class NeighboursOptions:
    """What `pose-eval neighbours` is asked for."""

    robots: int = told("How many.", 1000, min=2)
    town: int = told("Robots on the ring of each town.", 24, min=8, max=72)
    seed: int = told("Of the first town; each has textures of its own.", 0)
    workers: int = told("Processes that make the views.", 2, min=1)


@dataclass(frozen=True)
class WorldOptions:
    """Which world is served: the town square with robots on a ring, or a plan that fools, whose
    robots stand still.
    """

    robots: int = told("How many.", 6, min=1)
    seed: int = told("Of textures and noise.", 0)
    separation_deg: float | None = told(
        "Degrees between neighbours; else at most 45, varying.", None, "--separation"
    )
    moving: bool = told("The robots walk slowly.", False, "--moving")
    turning: tuple[str, ...] = told("A robot that looks to and fro; repeatable.", ())
    person: bool = told("Somebody walks before the second robot.", False, "--person")
    plan: PlanName | None = told(_FOOLS, metavar="PLACE")
    unique: int = told(_UNIQUE, 0, min=0)

    @property
    def moves(self) -> bool:
        """Whether any robot does."""
        return self.moving or bool(self.turning)


@dataclass(frozen=True)
class _Sets:
    """Recordings, any number of them."""

    data: tuple[Path, ...] = told(
        "Recording; each fleet begins at another view of it. Repeatable.", ()
    )
    clouds: CloudKind | None = told(CLOUDS)
    metres_per_unit: float | None = told(SCALE)

    def in_metres(self) -> tuple[Path, ...]:
        """Their folders, those of reconstructions made by the scale that was told.

        Raises:
            DataFolderError: a scale is told and there is no reconstruction.
        """
        from fleetpose.evaluation.data.reconstructed import all_in_metres

        return all_in_metres(self.data, self.metres_per_unit)

    def recordings(self) -> list["Recording"]:
        """Opens all of them.

        Raises:
            DataFolderError: one cannot be used.
        """
        from fleetpose.evaluation.data.opening import open_recordings

        return open_recordings(self.in_metres(), self.clouds)

    def recording(self) -> "Recording | None":
        """Opens the only one, where there is one.

        Raises:
            FleetPoseError: there are more, or it cannot be used.
        """
        from fleetpose.evaluation.data.opening import open_recording
        from fleetpose.protocol.errors import FleetPoseError

        if len(self.data) > 1:
            raise FleetPoseError(
                f"--data {self.data[1]}: give one here, several only with --offline"
            )
        found = self.in_metres()
        return open_recording(found[0], self.clouds) if found else None


@dataclass(frozen=True)
class FleetOptions(_Sets):
    """What `pose-eval fleet` is asked for."""

    robots: int | None = told("How many. [default: 6; offline 4 to 12 by chance]", min=2)
    seconds: float = told("After all processes are up; more than 20.", 60)
    data: tuple[Path, ...] = told(
        "Recording with ground truth; else the synthetic world. Offline: any.", ()
    )
    views: tuple[int, ...] = told(
        "A,B,C: one robot stands at each of these views of a recording.", (), text=Text(numbers)
    )
    offline: bool = told("Without network and clicks: many drawn fleets.", False, "--offline")
    seeds: int = told("Offline: fleets of each recording.", 20, min=1)
    first: int = told("Posed views: the first of consecutive views.", 0)
    skip_pairs: Path | None = told("Lines 'r1 r2': pairs left to the operator.")
    cluster: str | None = told("Dask scheduler that the server aligns on.")
    clicks_per_minute: float = told("Simulated operator.", 0.0, min=0)
    clicks_on_skipped: int = told(
        "The operator clicks so many points on each skipped pair.", 0, min=0
    )
    workers: int = told("Alignment processes.", 2, min=1)
    moving: bool = told("Synthetic robots walk.", False, "--moving")
    world: PlanName | None = told(_FOOLS, metavar="PLACE")
    unique: int = told(_UNIQUE, 0, min=0)
    seed: int = told("Of the synthetic world and the operator.", 0)
    mistakes: float = told("Share of questions answered wrongly, as people do.", 0.0, min=0, max=1)
    recipe: Literal["full", "paper"] = told(
        "Of the server; paper: the method as published, which judges nothing.", "full"
    )

    def refuse_offline(self) -> None:
        """Refuses options of live fleets beside --offline, rather than leaving them out unsaid.

        Raises:
            FleetPoseError: one was given.
        """
        from fleetpose.protocol.errors import FleetPoseError

        given = ["--recipe paper"] if self.recipe != "full" else []
        live = ("world", "clicks_per_minute", "clicks_on_skipped", "skip_pairs", "mistakes")
        for name in (*live, "cluster", "moving"):
            if getattr(self, name) not in (None, 0):
                given.append(f"--{name.replace('_', '-')}")
        if given:
            raise FleetPoseError(f"{' and '.join(given)}: of live fleets only, leave --offline out")


@dataclass(frozen=True)
class RestartsOptions(_Sets):
    """What `pose-eval restarts` is asked for."""

    restarts: int = told("How many fleets, one by one.", 30, min=1)
    robots: int = told("In each.", 8, min=2)
    seconds: float = told("From its start to its poses.", 12.0, min=1)
    workers: int = told("Alignment processes.", 2, min=1)
    seed: int = told("Of the first synthetic world; then one more.", 0)
    offline: bool = told("Without network, by the server's jobs and solver.", False, "--offline")


@dataclass(frozen=True)
class FaultOptions:
    """What `pose-eval faults` is asked for; what is 0 or not told is left out."""

    kills: int | None = told("Kill processes at random moments. [default: 20]", min=0)
    freeze_s: float | None = told(
        "Freeze one client, seconds. [default: 10]", None, "--freeze", min=0
    )
    late_clicks: int | None = told("Click in images half a minute old. [default: 1000]", min=0)
    inject: tuple[str, ...] = told(
        "Of none,skew,clock,baseline,mirrored,person,frozen,still,kidnapped,carried,"
        "carried-one,leave,old-epoch,clock-step; alone unless more is given.",
        (),
        text=Text(lambda _, text: tuple(text.split(",")) if text else ()),
    )
    inject_s: float = told("With each of these.", 50.0, "--seconds", min=10)
    inject_robots: int = told("With each of these.", 4, "--robots", min=3, max=16)
    seed: int = told("Which processes are killed, and when.", 0)

    def with_usual(self) -> Self:
        """Where nothing is to be injected, what is not told is as usual."""
        if self.inject:
            return self
        usual = {"kills": 20, "freeze_s": 10.0, "late_clicks": 1000}
        return replace(
            self, **{name: value for name, value in usual.items() if getattr(self, name) is None}
        )


@dataclass(frozen=True)
class SoakOptions:
    """What `pose-eval soak` is asked for."""

    hours: float = told("How long, after the fleet has come up.", 1.0, min=0.001)
    robots: int = told("That walk in the synthetic world.", 4, min=3, max=16)
    rate_hz: float = told("Views of each robot per second.", 0.5, "--rate", min=0.05)
    trouble_s: float = told("Seconds between two troubles.", 45.0, "--every", min=1.0)
    seed: int = told("Of the world, and of what happens to whom.", 0)


@dataclass(frozen=True)
class HmiOptions:
    """What `pose-eval hmi` is asked for."""

    robots: int = told("Robots in the fleet.", 72, min=2)
    seconds: float = told("Of the measurement of costs.", 60.0, min=5)
    moving: bool = told("Cameras that pan.", False, "--moving")
    targets: int = told("To pick, by keys and by mouse.", 50, min=1)
    size: tuple[int, int] = told("Columns x rows of the terminal.", (160, 50), text=_SIZE)


@dataclass(frozen=True)
class OperateOptions:
    """What `pose-eval operate` is asked for."""

    data: Path | None = told("Recording. [default: the synthetic world]")
    clouds: CloudKind | None = told(CLOUDS)
    metres_per_unit: float | None = told(SCALE)
    robots: int = told("The last one is kept apart.", 3, min=2)
    first: int = told("The first view.", 0, min=0)
    points: int = told("Points to click.", 3, min=1)
    by_hand: bool = told("Without the server's suggestions.", False)
    kill_server: bool = told("Kill it (SIGKILL) in the middle of the second click, by hand.", False)
    size: tuple[int, int] = told("Columns x rows of the terminal.", (160, 50), text=_SIZE)
    theme: str = told("Of the screen: auto, dark, light, mono.", "auto")

    def of_fleet(self) -> FleetOptions:
        """The fleet that is operated."""
        data = () if self.data is None else (self.data,)
        return FleetOptions(
            data, self.clouds, self.metres_per_unit, robots=self.robots, first=self.first
        )
