"""Which reconstruction a path holds, and reading it."""

from pathlib import Path

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.bundler import find_bundler, read_bundler
from fleetpose.robot_agent.reconstructions.colmap import find_colmap, read_colmap
from fleetpose.robot_agent.reconstructions.model import Reconstruction
from fleetpose.robot_agent.reconstructions.nvm import find_nvm, read_nvm

_READERS = ((find_colmap, read_colmap), (find_bundler, read_bundler), (find_nvm, read_nvm))


def find_reconstruction(path: Path) -> Path | None:
    """The file that says which reconstruction a folder holds; none if it holds none.

    Raises:
        DataFolderError: there are several.
    """
    found = [file for find, _ in _READERS for file in find(path)]
    if len(found) > 1:
        raise DataFolderError(
            f"{path} holds several reconstructions: name one, {' or '.join(map(str, found))}"
        )
    return found[0] if found else None


def read_reconstruction(path: Path, only: str | None = None) -> Reconstruction:
    """Reads what COLMAP, Bundler or VisualSfM left.

    Args:
        path: the folder, or the file that `find_reconstruction` names.
        only: name of the one image to take, with or without its ending; all if not given.

    Raises:
        DataFolderError: there is none or more than one, or it cannot be read; the text says why.
    """
    file = find_reconstruction(path)
    if file is None:
        raise DataFolderError(
            f"{path} holds no reconstruction: neither cameras.bin or cameras.txt (COLMAP), nor "
            "bundle.out (Bundler), nor an .nvm file (VisualSfM)"
        )
    read = next(read for find, read in _READERS if find(file))
    return read(file, only)
