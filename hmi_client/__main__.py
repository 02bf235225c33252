"""`hmi-client`: one place where errors become sentences."""

from fleetpose.hmi_client.cli.commands import app
from fleetpose.protocol.commands import run_command

UNREACHABLE = 3


def main() -> None:
    """Runs the command; bad input exits with 2, an unreachable fleet with 3."""
    run_command(app, "hmi-client", "hmi", UNREACHABLE)


if __name__ == "__main__":
    main()
