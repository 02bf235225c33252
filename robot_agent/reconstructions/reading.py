"""Which reconstruction a path holds, and reading it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fleetpose.formats.arrays import FormatError
from fleetpose.formats.reconstructions import bundler, colmap, nvm
from fleetpose.formats.reconstructions.photos import Model
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import OtherKindError
from fleetpose.robot_agent.reconstructions.model import Reconstruction
from fleetpose.robot_agent.reconstructions.photos import reconstruction_of

_BUNDLE = "bundle.out"
_MODEL_FOLDERS = ("", "sparse/0", "sparse", "dense/sparse")


@dataclass(frozen=True)
class Kind:
    """What one program leaves: its files in a folder, what they say, and where images may lie."""

    find: Callable[[Path], list[Path]]
    read: Callable[[Path], Model]
    image_folders: Callable[[Path], Sequence[Path]]


def find_colmap(path: Path) -> list[Path]:
    """The file of cameras of the first model in a folder; the path itself if it is such a file."""
    if path.name in colmap.CAMERA_FILES and path.is_file():
        return [path]
    files = (path / folder / name for folder in _MODEL_FOLDERS for name in colmap.CAMERA_FILES)
    return [file for file in files if file.is_file()][:1]


def find_bundler(path: Path) -> list[Path]:
    """The results in a folder, else those one folder below, as Bundler leaves them; the path itself
    if it is a bundle file.
    """
    if path.suffix.lower() == ".out" and path.is_file():
        return [path]
    here = path / _BUNDLE
    return [here] if here.is_file() else sorted(path.glob(f"*/{_BUNDLE}"))


def find_nvm(path: Path) -> list[Path]:
    """The results in a folder, or the path itself if it is one."""
    if path.suffix.lower() == ".nvm" and path.is_file():
        return [path]
    return sorted(path.glob("*.nvm"))


_KINDS = (
    Kind(find_colmap, colmap.read_colmap, colmap.image_folders),
    Kind(find_bundler, bundler.read_bundler, bundler.image_folders),
    Kind(find_nvm, nvm.read_nvm, nvm.image_folders),
)


def find_reconstruction(path: Path) -> Path | None:
    """The file that says which reconstruction a folder holds; none if it holds none.

    Raises:
        DataFolderError: there are several.
    """
    found = [file for kind in _KINDS for file in kind.find(path)]
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
        raise OtherKindError(
            f"{path} holds no reconstruction: neither cameras.bin or cameras.txt (COLMAP), nor "
            "bundle.out (Bundler), nor an .nvm file (VisualSfM)"
        )
    kind = next(kind for kind in _KINDS if kind.find(file))
    try:
        model = kind.read(file)
    except FormatError as error:
        raise DataFolderError(str(error)) from error
    source = file.parent if file.name in colmap.CAMERA_FILES else file
    return reconstruction_of(source, model, kind.image_folders(file), only)
