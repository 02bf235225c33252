"""A session read from a copy of a state folder, solved; its server may be running."""

import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.persistence.graph_store import read_graph
from fleetpose.pose_server.persistence.restore import folder_files, restored_site
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.errors import FleetPoseError


class ExportError(FleetPoseError):
    """There is nothing to export, or no place for it."""


@contextmanager
def opened_session(state_dir: Path) -> Iterator[tuple[Site, Journal]]:
    """The site and the journal of a state folder as they are now, with the covariances of all
    keyframes.

    Raises:
        FleetPoseError: there is no session, or it cannot be read.
    """
    journal_file, graph_file = folder_files(state_dir)
    if not journal_file.exists():
        raise ExportError(
            f"{state_dir} holds no session: give the --state-dir that the server was started with"
        )
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        copy = Path(scratch) / journal_file.name
        try:
            uri = f"{journal_file.absolute().as_uri()}?mode=ro"
            with (
                closing(sqlite3.connect(uri, uri=True)) as source,
                closing(sqlite3.connect(copy)) as target,
            ):
                source.backup(target)  # a moment of a server that may go on writing
        except sqlite3.Error as error:
            raise ExportError(f"{journal_file} cannot be read: {error}") from error
        with Journal(copy) as journal:
            site = restored_site(journal, read_graph(graph_file))
            while site.dirty:  # choosing an anchor makes it dirty once more
                pipeline.solve(site, 0.0, wanted=site.keyframes())
            pipeline.judge_correspondences(site)
            yield site, journal
