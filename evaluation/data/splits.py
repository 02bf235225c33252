"""Which places the server's constants were fitted on; all others are held out.

A figure on a place that a constant was fitted on says how well it was fitted, not how well it
holds: reports name the split beside each figure. Places are recordings, by the name of their
folder, and plans of the synthetic world, as `plan NAME`. Whoever fits anything on a place that is
not here adds it in the same commit.
"""

import re
from pathlib import Path
from typing import Literal

Split = Literal["fitted", "held out"]

FITTED: dict[str, frozenset[str]] = {
    "covariance": frozenset({"church_herzjesu", "ring_temple", "rgbd_7scenes_redkitchen_A"}),
    "verdict": frozenset(
        {
            *("church_herzjesu", "ring_temple", "house_dtu24", "rgbd_7scenes_redkitchen_A"),
            *("plan courtyard2", "plan facade", "plan weak", "plan corridor"),
        }
    ),
}
"""Places by what was fitted on them: the covariances' inflation and floor, the verdict's limits."""


def place_of(directory: Path) -> str:
    """What a folder shows, whatever it is called where it was made by `pose-eval synth`."""
    source = directory / "SOURCE.txt"
    text = source.read_text(errors="replace") if source.is_file() else ""
    plan = re.search(r"`pose-eval synth\b[^`]*--world\s+(\w[\w-]*)", text)
    return f"plan {plan[1]}" if plan else directory.resolve().name


def fitted_on(place: str) -> list[str]:
    """What was fitted on a place, among others."""
    return sorted(what for what, places in FITTED.items() if place in places)


def split_of(directory: Path) -> Split:
    """Whether anything was fitted on what a folder shows."""
    return "fitted" if fitted_on(place_of(directory)) else "held out"
