"""A disk of its own for the server's folder, which can be filled: a file system in memory."""

import os
import subprocess
from pathlib import Path

from fleetpose.protocol.errors import FleetPoseError

SIZE_BYTES = 128 << 20
LEFT_BYTES = 32 << 10
"""What is left of a disk that is nearly full: room for a few of a journal's pages."""
_BALLAST = "ballast"


class Disk:
    """Mounts it; to be closed.

    Args:
        folder: where; made if missing.

    Raises:
        FleetPoseError: it cannot be mounted.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        kind = ("-t", "tmpfs", "-o", f"size={SIZE_BYTES}", "tmpfs")
        done = subprocess.run(["mount", *kind, str(folder)], capture_output=True, text=True)
        if done.returncode != 0:
            raise FleetPoseError(f"no disk can be mounted at {folder}: {done.stderr.strip()}")

    @property
    def free_bytes(self) -> int:
        room = os.statvfs(self.folder)
        return room.f_bavail * room.f_frsize

    def fill(self) -> None:
        """Leaves next to no room."""
        with (self.folder / _BALLAST).open("wb") as ballast:
            os.posix_fallocate(ballast.fileno(), 0, max(self.free_bytes - LEFT_BYTES, 1))

    def empty(self) -> None:
        """Makes room again."""
        (self.folder / _BALLAST).unlink(missing_ok=True)

    def close(self) -> None:
        """Unmounts it; what is still open on it goes with its process."""
        subprocess.run(["umount", "--lazy", str(self.folder)], check=True)
