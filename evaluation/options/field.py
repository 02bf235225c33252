"""What `pose-eval field` is asked for. Nothing heavy is imported."""

from dataclasses import dataclass

from fleetpose.evaluation.options.building import told


@dataclass(frozen=True)
class FieldOptions:
    """What `pose-eval field` is asked for; what is not told is left out."""

    attacks: bool = told(
        "Have members and strangers say, hear, ask and answer what they may not.",
        False,
        "--attacks",
    )
    robots: int = told("That stand in the synthetic world.", 3, min=3, max=8)
    quiet_s: float = told("Without attacks, to count false alarms.", 60.0, "--quiet", min=1)
