"""Correspondences from files into a session: what `pose-server import` does."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.journal import Journal, StoredView
from fleetpose.pose_server.persistence.export import VIEWS, view_file
from fleetpose.pose_server.persistence.graph_writer import stored_graph
from fleetpose.pose_server.persistence.restore import folder_files, restored_site
from fleetpose.pose_server.persistence.table import Click, read_rows
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import new_epoch
from fleetpose.protocol.messages import KeptView, OperatorUpdate, ViewName


@dataclass
class Imported:
    """What became of the rows.

    Attributes:
        refused: where a row stands, and why it was refused.
    """

    accepted: int = 0
    duplicates: int = 0
    refused: list[tuple[str, str]] = field(default_factory=list)


def import_files(
    state_dir: Path, files: Sequence[Path], progress: Callable[[], None] = lambda: None
) -> Imported:
    """Takes correspondences as if an operator clicked them now: each is checked, lifted and
    journalled, or refused with a reason. Views that are not in the session are taken from the
    folder `views` beside a file.

    Args:
        state_dir: of a server that does not run.
        files: JSON or CSV files, or folders that `pose-server export` made.
        progress: called after each row.

    Raises:
        FleetPoseError: a server is using the folder, or a file holds no correspondences.
    """
    paths = [path / "correspondences.json" if path.is_dir() else path for path in files]
    rows = [(path, row) for path in paths for row in read_rows(path)]  # before anything is done
    journal_file, graph_file = folder_files(state_dir)
    found = Imported()
    with Journal(journal_file) as journal:
        site = restored_site(journal, stored_graph(graph_file))
        desk = _Desk(site, journal)
        for path, row in rows:
            reason = row.problem
            if row.click is not None:
                reason = desk.put(row.click, path.parent / VIEWS)
            if not reason:
                found.accepted += 1
            elif reason.startswith("duplicate"):
                found.duplicates += 1
            else:
                found.refused.append((row.place, reason))
            progress()
    return found


class _Desk:
    """An operator who clicks what the files say; every operator's name has a session of its own."""

    def __init__(self, site: Site, journal: Journal) -> None:
        self._site, self._journal = site, journal
        self._session = new_epoch()
        self._sent: dict[str, int] = {}

    def put(self, click: Click, folder: Path) -> str:
        """Puts one correspondence; returns why it was refused, or nothing."""
        (view_i, pixel_i), (view_j, pixel_j) = click.ends
        images: list[StoredView] = []
        for view in (view_i, view_j):
            try:
                images += self._fetch(view, folder)
            except FleetPoseError as error:
                return str(error)
        n = self._sent[click.operator] = self._sent.get(click.operator, 0) + 1
        update = OperatorUpdate(
            operator=click.operator,
            session=self._session,
            n=n,
            action="add",
            i=view_i.robot,
            j=view_j.robot,
            base_revision=0,
            view_i=view_i,
            view_j=view_j,
            pixel_i=np.array(pixel_i),
            pixel_j=np.array(pixel_j),
        )
        (outcome,) = pipeline.receive_update(self._site, update)
        for image in images if outcome.accepted else ():
            self._journal.keep_view(image)
        return outcome.reason

    def _fetch(self, view: ViewName, folder: Path) -> list[StoredView]:
        """Has a view in the session; what of it is to be journalled with its image."""
        if view in self._site.views:
            return []
        path = view_file(folder, view)
        if not path.exists():
            return []  # the server's own refusal says it
        try:
            kept = unpack(KeptView, path.read_bytes())
            opened = open_view(pack(kept.view), None, time.monotonic())
        except (OSError, CodecError) as error:
            raise FleetPoseError(f"{path} cannot be read: {error}") from error
        if opened.name != view:
            raise FleetPoseError(f"{path} holds another view: {opened.name}")
        self._site.robot(view.robot)
        self._site.views.keep(opened)
        return [StoredView(view, opened.payload, kept.jpeg, kept.image)]
