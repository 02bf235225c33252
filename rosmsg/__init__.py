"""What messages of ROS 1 and ROS 2 mean, and how bags of them are read, without ROS.

Arrays and plain records come out; nothing here knows the network, cameras or clocks.
"""

from pathlib import Path

SUFFIXES = (".mcap", ".db3", ".bag")
METADATA = "metadata.yaml"


def is_bag(path: Path) -> bool:
    """Whether a file is called like a bag's, or a folder holds what a recorder writes into one."""
    if path.is_dir():
        return (path / METADATA).is_file() or any(p.suffix in SUFFIXES for p in path.iterdir())
    return path.is_file() and path.suffix in SUFFIXES
