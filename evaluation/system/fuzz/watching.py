"""An operator's client without a screen, as a process: selects a pair so that images come, decodes
them as the screen does, and prints what it drops.

`python -m fleetpose.evaluation.system.fuzz.watching ENDPOINT SITE OPERATOR ROBOT ROBOT`
"""

import json
import sys
import time

from fleetpose.hmi_client.cli.connection import Connection
from fleetpose.hmi_client.cli.reports import Watcher
from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.picture_decoder import decoded


def main(endpoint: str, site: str, operator: str, a: str, b: str) -> None:
    """Prints what `hmi-client watch --json` prints until it is ended."""
    where = Connection((endpoint,), site, None, operator)
    with where.client_of_server() as client:
        session = client.session
        session.select(a, b)
        watcher = Watcher(session)
        while client.failure is None:
            for robot in (a, b):
                picture = session.picture(robot)
                if picture is not None:
                    try:
                        decoded(picture)
                    except PictureError as error:
                        session.drop(f"image of {robot}", error)
                        session.on_unreadable(robot, str(error), picture.view)
            for record in watcher.news():
                print(json.dumps(record), flush=True)
            time.sleep(0.25)


if __name__ == "__main__":
    main(*sys.argv[1:])
