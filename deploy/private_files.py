"""Files that only their owner may read, written whole or not at all."""

import os
import tempfile
from pathlib import Path

PRIVATE, PUBLIC, FOLDER = 0o600, 0o644, 0o700


def write_file(path: Path, content: bytes | str, mode: int = PRIVATE) -> None:
    """Writes a file in one step, so that a reader never finds half of it; never readable by others
    before its mode is set.
    """
    data = content.encode() if isinstance(content, str) else content
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
    try:
        with os.fdopen(handle, "wb") as file:
            os.fchmod(handle, mode)
            file.write(data)
            file.flush()
            os.fsync(handle)
        Path(scratch).replace(path)
    except BaseException:
        Path(scratch).unlink(missing_ok=True)
        raise


def make_folder(path: Path, mode: int = FOLDER) -> None:
    """Makes a folder and what is missing above it; its own mode is set whatever the umask."""
    path.mkdir(parents=True, exist_ok=True)
    path.chmod(mode)


def readable_by_others(path: Path) -> bool:
    """Whether group or others may do anything with it."""
    return bool(path.stat().st_mode & 0o077)
