"""Which rules a router runs, as it tells those who may ask."""

import json
from typing import Any

import zenoh

from fleetpose.deploy.manifest import RouterAddress
from fleetpose.deploy.site.permissions import ADMIN
from fleetpose.protocol.session.echo import ECHO_S, client_of


def running_rules(configuration: dict[str, Any], router: RouterAddress) -> dict[str, str] | None:
    """What a router tells of the rules it runs: `site`, `role`, `name`, `rules` (their hash).

    Returns:
        None where it does not answer: it is not reached, or its rules do not let who asks.
    """
    try:
        with client_of(configuration, [router.endpoint]) as session:
            here = {str(zid) for zid in session.info.routers_zid()}
            for reply in session.get(ADMIN, timeout=ECHO_S):
                told = json.loads(reply.ok.payload.to_bytes()) if reply.ok is not None else {}
                if told.get("zid") in here:  # others of the site answer too
                    return (told.get("metadata") or {}).get("fleetpose")
    except zenoh.ZError:
        return None
    return None
