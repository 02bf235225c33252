"""`pose-eval`: measures everything against ground truth."""

import sys

import typer

from fleetpose.evaluation.cli import fleets, live, pairs

app = typer.Typer(no_args_is_help=True, add_completion=False, rich_markup_mode=None)
for subject in (pairs, fleets, live):
    app.add_typer(subject.app)


@app.callback()
def _commands() -> None:
    """Measure the system against ground truth."""


def main() -> None:
    """Runs the command; errors that a user can mend are one sentence and exit code 2."""
    from fleetpose.protocol.errors import FleetPoseError

    try:
        app()
    except FleetPoseError as error:
        print(f"pose-eval: {error}", file=sys.stderr)
        sys.exit(2)
    except ModuleNotFoundError as error:
        print(
            f"pose-eval: {error.name} is not installed: pip install 'fleetpose[eval]'",
            file=sys.stderr,
        )
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
