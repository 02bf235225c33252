"""One agent per name: a second one is refused while the first lives."""

from protocol.errors import FleetPoseError
from protocol.keys import Keys
from protocol.transport import Link, wait_until

LEASE_S = 2.0
"""So long a process that died without a word still seems alive."""


class NameTakenError(FleetPoseError):
    """Another live agent has the name."""


def claim_name(link: Link, keys: Keys, name: str, epoch: str, takeover: bool = False) -> None:
    """Shows this agent as alive under its name, from now to the end of the session.

    Args:
        link: the session.
        keys: keys of the site.
        name: the robot's name.
        epoch: this life of the agent.
        takeover: claim the name even while another agent has it.

    Raises:
        NameTakenError: another agent was alive under the name, and still is after one lease.
    """
    everybody = keys.robot_alive(name, "*")
    if not takeover and not wait_until(lambda: not link.alive(everybody), LEASE_S, poll_s=0.1):
        others = ", ".join(link.alive(everybody))
        raise NameTakenError(
            f"a robot named '{name}' is already alive ({others}): choose another --name, "
            "end that agent, or start with --takeover"
        )
    link.token(keys.robot_alive(name, epoch))
