"""An operator's clicks by a program: the same points in the newest images of two robots.

python examples/click.py ENDPOINT ROBOT_A ROBOT_B  UA,VA,UB,VB ...
"""

import sys

from fleetpose.hmi_client.cli.clicking import finish
from fleetpose.hmi_client.cli.connection import Connection

WAIT_S = 10.0  # for the server's receipt: then a click is safe in its journal


def main(endpoint: str, robot_a: str, robot_b: str, *points: str) -> None:
    """Sends the clicks and prints what became of each."""
    fleet = Connection.of([endpoint], site="demo", config=None, operator="program")
    with fleet.server() as session:
        view_a, view_b = (session.robot(name).newest_view for name in (robot_a, robot_b))
        if view_a is None or view_b is None:
            sys.exit("one of them has sent no view yet")
        tickets = []
        for point in points:
            u_a, v_a, u_b, v_b = map(float, point.split(","))
            tickets.append(session.add(view_a, (u_a, v_a), view_b, (u_b, v_b)))
        finish(session, tickets, WAIT_S)
        for point, ticket in zip(points, tickets, strict=True):
            print(point, "accepted" if ticket.accepted else ticket.reason or "not confirmed")


if __name__ == "__main__":
    main(*sys.argv[1:])
