"""`hmi-client`: one place where errors become sentences."""

import sys

from fleetpose.protocol.errors import FleetPoseError, UnreachableError

EXTRA = {"cv2", "textual", "rich"}


def main() -> None:
    """Runs the command; bad input exits with 2, an unreachable fleet with 3."""
    try:
        from fleetpose.hmi_client.cli.commands import app

        app()
    except UnreachableError as error:
        print(f"hmi-client: {error}", file=sys.stderr)
        sys.exit(3)
    except FleetPoseError as error:
        print(f"hmi-client: {error}", file=sys.stderr)
        sys.exit(2)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in EXTRA:
            raise
        print(
            f"hmi-client: '{error.name}' is missing; install it with: pip install 'fleetpose[hmi]'",
            file=sys.stderr,
        )
        sys.exit(2)


if __name__ == "__main__":
    main()
