"""Builds a service from its settings."""

import logging
from pathlib import Path

from fleetpose.pose_server.app.service import Service
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.geometry.errors import MissingLibraryError
from fleetpose.pose_server.geometry.icp import open3d
from fleetpose.pose_server.persistence.graph_writer import stored_graph
from fleetpose.pose_server.persistence.restore import folder_files, restored_site
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import checked_name, ordered_pair
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.transport import Link, SessionSettings, open_session

log = logging.getLogger("pose_server")


def build(settings: ServerSettings) -> Service:
    """Opens the journal, then the session; what was journalled is there again.

    Raises:
        FleetPoseError: the journal is in use, the router is not there, a file is malformed, or a
            library is missing.
    """
    log_to_stderr()
    if settings.icp.startswith("point_to"):
        try:
            open3d()
        except MissingLibraryError as error:
            raise FleetPoseError(f"--icp {settings.icp}: {error}") from error
    skip = frozenset() if settings.skip_pairs is None else read_pairs(settings.skip_pairs)
    journal_file, graph_file = folder_files(settings.state_dir)
    journal = Journal(journal_file)
    site = restored_site(
        journal,
        stored_graph(graph_file),
        skip,
        settings.anchor,
        located_sigma=settings.located_sigma,
        located_grave=settings.located_grave,
        recipe=settings.recipe,
        icp=settings.icp,
        weights=Weights(settings.weight_clicks, settings.weight_error, settings.retry_s),
    )
    endpoints = SessionSettings(settings.connect, settings.listen, settings.config)
    return Service(site, journal, Link(open_session(endpoints)), settings)


def read_pairs(path: Path) -> frozenset[tuple[str, str]]:
    """Reads lines of two robots' names; `#` begins a comment.

    Raises:
        FleetPoseError: the file cannot be read or a line does not hold two names.
    """
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise FleetPoseError(f"cannot read the pairs to skip: {error}") from error
    pairs = set()
    for number, line in enumerate(lines, 1):
        names = line.split("#")[0].split()
        if not names:
            continue
        if len(names) != 2 or names[0] == names[1]:
            raise FleetPoseError(f"{path}:{number}: two robots' names were expected, not '{line}'")
        pairs.add(ordered_pair(checked_name(names[0]), checked_name(names[1])))
    return frozenset(pairs)
