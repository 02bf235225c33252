"""Builds a service from its settings."""

import logging
import threading
from contextlib import ExitStack
from pathlib import Path

from fleetpose.pose_server.app.metrics import Metrics
from fleetpose.pose_server.app.service import Service
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.geometry.errors import MissingLibraryError
from fleetpose.pose_server.geometry.icp import open3d
from fleetpose.pose_server.persistence.graph_writer import stored_graph
from fleetpose.pose_server.persistence.restore import folder_files, restored_site
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.workers.dask_pool import ClusterPool
from fleetpose.pose_server.workers.pools import LocalPool
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import checked_name, ordered_pair
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.session.supervisor import Supervisor
from fleetpose.protocol.transport import Link, SessionSettings, open_session

log = logging.getLogger("pose_server")


def build(
    settings: ServerSettings, stopped: threading.Event, systemd: Supervisor | None = None
) -> Service:
    """Judges the settings, opens the journal and what the settings name, and last the session, for
    which it may have to wait; what was journalled is there again. What was opened is closed where
    something fails.

    Args:
        settings: of the server.
        stopped: set when the process is to end.
        systemd: is told how it is.

    Raises:
        FleetPoseError: the journal is in use, the router is not there in time, a file is
            malformed, an address is taken, or a library is missing.
    """
    log_to_stderr()
    systemd = systemd or Supervisor()
    endpoints = SessionSettings(
        settings.connect,
        settings.listen,
        settings.config,
        settings.connect_timeout_s,
        stopped,
        systemd.alive,
    )
    endpoints.configuration()  # refused before anything is opened
    if settings.icp.startswith("point_to"):
        try:
            open3d()
        except MissingLibraryError as error:
            raise FleetPoseError(f"--icp {settings.icp}: {error}") from error
    skip = frozenset() if settings.skip_pairs is None else read_pairs(settings.skip_pairs)
    journal_file, graph_file = folder_files(settings.state_dir)
    with ExitStack() as opened:
        metrics = None if settings.metrics is None else Metrics(settings.metrics)
        if metrics is not None:
            opened.callback(metrics.close)
        journal = Journal(journal_file)
        opened.callback(journal.close)
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
        pool = ClusterPool(settings.cluster) if settings.cluster else LocalPool(settings.workers)
        opened.callback(pool.close)
        systemd.ready()
        link = Link(open_session(endpoints))
        opened.callback(link.close)
        service = Service(site, journal, link, settings, pool, metrics, stopped, systemd)
        opened.pop_all()
    return service


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
