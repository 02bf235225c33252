"""Which views of a recording each robot of a fleet sees."""

from collections.abc import Sequence

from fleetpose.evaluation.data.recording import Recording, TrueView, in_ring_order
from fleetpose.protocol.errors import DataFolderError


def parts_of(
    recording: Recording, robots: int, first: int, named: Sequence[int] = ()
) -> list[list[TrueView]]:
    """What each robot sees: one of the views that are named, else one of consecutive views, or one
    of equal contiguous stretches.

    Raises:
        DataFolderError: the recording has too few views.
    """
    if named:
        return [[view] for view in checked_views(recording, named)]
    views = in_ring_order(recording.usable)
    if recording.is_rgbd:
        length = len(views) // robots
        if not length:
            raise DataFolderError(f"{len(views)} frames cannot be shared among {robots} robots")
        return [list(views[k * length : (k + 1) * length]) for k in range(robots)]
    if not 0 <= first < len(views) or robots > len(views):
        raise DataFolderError(
            f"{robots} robots from view {first} on: {recording.directory} has {len(views)} views"
        )
    ring = any(view.ring_angle_deg is not None for view in views)
    if not ring and first + robots > len(views):
        raise DataFolderError(f"only {len(views) - first} views from view {first} on")
    return [[views[(first + k) % len(views)]] for k in range(robots)]


def checked_views(recording: Recording, views: Sequence[int]) -> tuple[TrueView, ...]:
    """The views that `--views` names, in that order, if robots can stand there.

    Raises:
        DataFolderError: there is no such view, it has no cloud, or it is named twice.
    """
    usable = {view.index: view for view in recording.usable}
    missing = [index for index in views if index not in usable]
    if missing:
        raise DataFolderError(
            f"--views {missing[0]}: {recording.directory} has the views 0 to "
            f"{len(recording.views) - 1}, {len(usable)} of them with a cloud"
        )
    if len(set(views)) < len(views) or len(views) < 2:
        raise DataFolderError("--views: name at least two, each once")
    return tuple(usable[index] for index in views)
