"""Builds a service from its settings."""

import logging
import os
import time
from pathlib import Path

# one thread per process: the workers are the parallelism
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from pose_server import pipeline  # noqa: E402
from pose_server.correspondences.book import Book  # noqa: E402
from pose_server.correspondences.journal import Journal, StoredView  # noqa: E402
from pose_server.service import Service  # noqa: E402
from pose_server.settings import ServerSettings  # noqa: E402
from pose_server.site import Site  # noqa: E402
from pose_server.views import KeptView, open_view  # noqa: E402
from protocol.errors import CodecError, FleetPoseError  # noqa: E402
from protocol.keys import checked_name, ordered_pair  # noqa: E402
from protocol.logs import log_to_stderr  # noqa: E402
from protocol.transport import Link, SessionSettings, open_session  # noqa: E402

log = logging.getLogger("pose_server")


def build(settings: ServerSettings) -> Service:
    """Opens the journal, then the session; what was journalled is there again.

    Raises:
        FleetPoseError: the journal is in use, the router is not there, or a file is malformed.
    """
    log_to_stderr()
    skip = frozenset() if settings.skip_pairs is None else read_pairs(settings.skip_pairs)
    journal = Journal(settings.state_dir / "journal.sqlite3")
    site = Site(
        located_sigma=settings.located_sigma,
        book=Book(journal),
        skip=skip,
        anchor=settings.anchor or journal.noted("anchor"),
        gauge_revision=int(journal.noted("gauge_revision") or 0),
    )
    now_s = time.monotonic()
    pipeline.restore(site, [view for stored in journal.views() if (view := _opened(stored, now_s))])
    endpoints = SessionSettings(settings.connect, settings.listen, settings.config)
    return Service(site, journal, Link(open_session(endpoints)), settings)


def _opened(stored: StoredView, now_s: float) -> KeptView | None:
    """A journalled view; one that cannot be read costs that view, not the server."""
    try:
        return open_view(stored.encoded, None, now_s)
    except CodecError as error:
        log.error("journalled view %s is left out: %s", stored.name, error)
        return None


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
