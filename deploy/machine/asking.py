"""What a router runs, asked by the site's keeper with a bundle that is not installed anywhere."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from fleetpose.deploy.machine.bundle import configuration_of, read_bundle
from fleetpose.deploy.machine.install import plan_install
from fleetpose.deploy.machine.installed import tls_files
from fleetpose.deploy.machine.running import running_rules
from fleetpose.deploy.manifest import CONFIGURATION
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.session.probe import why_refused


def rules_of_router(path: Path, name: str, ask_password: Callable[[], str]) -> str:
    """The hash of the rules that a router runs.

    Args:
        path: a bundle whose owner may ask routers.
        name: of the router.
        ask_password: for a bundle that needs one.

    Raises:
        UnreachableError: there is no such router, or it does not answer, and why.
    """
    bundle = read_bundle(path, ask_password)
    routers = {router.name: router for router in bundle.manifest.routers}
    if name not in routers:
        raise UnreachableError(f"site '{bundle.manifest.site}' has no router '{name}'")
    with tempfile.TemporaryDirectory() as scratch:
        plan = plan_install(bundle, Path(scratch))
        plan.write()
        configuration = configuration_of(
            (plan.folder / CONFIGURATION).read_bytes(), str(plan.folder)
        )
        told = running_rules(configuration, routers[name])
        if told is None:
            why = why_refused(routers[name].endpoint, tls_files(plan.folder))
            raise UnreachableError(
                f"router {name}: {why or 'it does not tell what it runs: are its rules older?'}"
            )
    return told.get("rules", "unknown")
