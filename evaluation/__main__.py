"""`pose-eval`: measures everything against ground truth."""

import sys

from fleetpose.evaluation.cli import fleets, live, pairs
from fleetpose.protocol.commands import Version, command_line, require, run_command

app = command_line()
for subject in (pairs, fleets, live):
    app.add_typer(subject.app)


@app.callback()
def _commands(version: Version = False) -> None:
    """Measure the system against ground truth."""
    if "--help" not in sys.argv:  # what a command does can be read without
        require("eval")


def main() -> None:
    """Runs the command line; what a user can mend is one sentence and exit code 2."""
    run_command(app, "pose-eval", "eval")


if __name__ == "__main__":
    main()
