"""A zenoh router as a process of its own: used as soon as a second process or machine joins.

Where its configuration says whose it is, it tells what its rules deny and whom it does not let in:
who is denied learns nothing of it.
"""

import logging
import signal
import threading
from collections.abc import Callable
from pathlib import Path

from fleetpose.pose_server.routing.denials import DenialCounts
from fleetpose.pose_server.routing.zenoh_log import ZenohLog
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys, new_epoch
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.messages import Denials
from fleetpose.protocol.session.identity import Identity, identity_in
from fleetpose.protocol.session.supervisor import Supervisor
from fleetpose.protocol.transport import Link, SessionSettings, open_session

log = logging.getLogger("router")

_TELL_S = 1.0


def route(listen: tuple[str, ...], config: Path | None) -> None:
    """Routes until SIGTERM or SIGINT; a zenoh configuration replaces the endpoints.

    Raises:
        EndpointError: an endpoint is taken, or the configuration cannot be used.
    """
    log_to_stderr()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    identity = None if config is None else identity_in(config, ("router",))
    counts, systemd = DenialCounts(), Supervisor()
    with ZenohLog(counts.read):
        link = Link(open_session(SessionSettings(listen=listen, config_file=config)))
        log.info("router at %s", config or ", ".join(listen))
        systemd.ready()
        tell = (lambda: None) if identity is None else _teller(link, identity, counts)
        try:
            while not stop.wait(_TELL_S):
                tell()
                systemd.alive(f"{sum(counts.refused.values())} handshakes failed")
        finally:
            systemd.stopping()
            link.close()


def _teller(link: Link, identity: Identity, counts: DenialCounts) -> Callable[[], None]:
    """What publishes the denials when there are others than before."""
    publisher = link.latched(Keys(identity.site).denials(identity.name))
    epoch, told = new_epoch(), None

    def tell() -> None:
        nonlocal told
        message = counts.message(identity.name, epoch)
        if message != told:
            told = message
            publisher.put(pack(message), encoding_of(Denials))

    return tell
