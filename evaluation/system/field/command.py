"""Runs what is asked for of `pose-eval field`, prints it and writes `summary.json`."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.report.output import output_folder, write_summary
from fleetpose.protocol.errors import FleetPoseError

Part = Callable[[FieldOptions, Path, Path], dict[str, Any]]


def run(options: FieldOptions, out: Path) -> dict[str, Any]:
    """Runs each part in a site and a fleet of its own; returns the summary.

    Raises:
        FleetPoseError: nothing is asked for, certificates cannot be made, or a fleet fails.
    """
    parts = _parts(options)
    logs = output_folder(out) / "logs"
    for old in logs.glob("*/*.log"):
        old.unlink()
    summary: dict[str, Any] = {}
    for name, part in parts.items():
        with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
            told = part(options, Path(scratch), logs / name)
        summary |= {f"{name}_{key}": value for key, value in told.items()}
    write_summary(out, summary, "field")
    return summary


def _parts(options: FieldOptions) -> dict[str, Part]:
    try:
        import cryptography  # noqa: F401  what makes the site's certificates
    except ImportError as error:
        raise FleetPoseError(
            "certificates are made with cryptography: pip install 'fleetpose[deploy]'"
        ) from error
    from fleetpose.evaluation.system.field import attacks, cost, flood, rotate, routers, silent
    from fleetpose.evaluation.system.radio import run as radio

    asked: dict[str, tuple[bool, Part]] = {
        "attacks": (options.attacks, attacks.run),
        "silent": (options.silent, silent.run),
        "rotate": (options.rotate, rotate.run),
        "kills": (bool(options.kills), routers.run),
        "flood": (options.flood, flood.run),
        "radio": (options.radio is not None, radio.run),
        "cost": (options.cost, cost.run),
    }
    parts = {name: part for name, (wanted, part) in asked.items() if wanted}
    if not parts:
        raise FleetPoseError("nothing to do: give " + ", ".join(f"--{name}" for name in asked))
    return parts
