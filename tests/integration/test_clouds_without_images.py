"""Two sensors without images in a live fleet: agents, server and the operator's picture."""

import json

import cv2
import numpy as np
import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.system.fleet import open_link
from fleetpose.evaluation.system.observer import Observer
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, KeptView, RelativePose
from fleetpose.protocol.transport import wait_until
from tests.pose_server.test_surfaces import corner, walked

FOUND_S = 90.0


def seen(points):
    """What of points (N, 3) a sensor at the origin sees, the nearest in every direction."""
    cell = np.floor(points[:, :2] / points[:, 2:] * 150).astype(int) @ (1, 100_000)
    _, cell = np.unique(cell, return_inverse=True)
    nearest = np.full(cell.max() + 1, np.inf)
    np.minimum.at(nearest, cell, points[:, 2])
    return points[(points[:, 2] > 0.3) & (points[:, 2] < nearest[cell] + 0.05)]


@pytest.mark.timeout(240)
def test_robots_without_images_are_located_and_can_be_clicked(tmp_path):
    T_1_2 = walked(20, 0.3)
    for name, T in (("r1", np.eye(4)), ("r2", inverse(T_1_2))):
        rng = np.random.default_rng(int(name[1]))
        points = seen(transform(T, corner(rng))) + rng.normal(0, 0.004, 3)
        np.save(tmp_path / f"{name}.npy", points @ ROBOT_FROM_CAMERA[:3, :3].T)
    with LocalFleet(tmp_path) as fleet:
        fleet.start_router()
        fleet.start_server("--workers", "1", state=tmp_path / "state")
        for name in ("r1", "r2"):
            fleet.start_robot(name, "cloud", str(tmp_path / f"{name}.npy"), "--replay", "loop")
        link = open_link(fleet)
        keys, observer = Keys(fleet.site), Observer(link, Keys(fleet.site))

        def relative() -> RelativePose | None:
            try:
                answer = link.query(f"{keys.relative}?from=r1;to=r2")
            except UnreachableError:
                return None
            return unpack(RelativePose, answer.payload, answer.encoding)

        try:
            found = wait_until(lambda: (told := relative()) and told.located, FOUND_S)
            assert found, (relative(), fleet.tail("server"))
            told = relative()
            assert told is not None
            T_a_b = ROBOT_FROM_CAMERA @ T_1_2 @ inverse(ROBOT_FROM_CAMERA)
            assert np.linalg.norm(told.T_a_b[:3, 3] - T_a_b[:3, 3]) < 0.05
            answer = link.query(f"{keys.view('r1')}")
            kept = unpack(KeptView, answer.payload, answer.encoding)
            assert kept.jpeg is not None and not kept.view.has_image
            picture = cv2.imdecode(np.frombuffer(kept.jpeg, np.uint8), cv2.IMREAD_COLOR)
            assert picture.shape[:2] == (kept.view.camera.height, kept.view.camera.width)
            assert (picture.max(axis=2) > 40).mean() > 0.2  # there is something to pick in
            assert kept.view.salient.count == 0
        finally:
            observer.close()
            link.close()
    assert not json.dumps(fleet.exited()).count("Traceback")
