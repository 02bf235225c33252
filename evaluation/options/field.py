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
    silent: bool = told("Break robots' links in ten ways; is the cause named?", False, "--silent")
    rotate: bool = told(
        "Renew, revoke, and change the rules while clicks go on.", False, "--rotate"
    )
    routers: int = told("Of the site, for --kills.", 2, min=1, max=2)
    kills: int = told("Kill a router so many times under clicks.", 0, min=0)
    flood: bool = told("Have a robot send as fast as it can.", False, "--flood")
    cost: bool = told(
        "Clicks and CPU with TLS and access control, beside a plain router.", False, "--cost"
    )
    robots: int = told("That stand in the synthetic world.", 3, min=3, max=8)
    quiet_s: float = told("Without attacks, to count false alarms.", 60.0, "--quiet", min=1)
    seed: int = told("Which routers are killed, and when.", 0)
