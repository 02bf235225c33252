"""A ring's fleet in 3D, like the paper's Fig. 8: where the solver puts the robots, and what they
saw from there.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetpose.evaluation.bench.clicks.worker import ClickedAnswer, kept
from fleetpose.evaluation.bench.ring.layout import Ring
from fleetpose.evaluation.bench.ring.solving import Pair, connected, solution_of
from fleetpose.pose_server.frontend.frames import in_fleet
from fleetpose.pose_server.geometry.se3 import position_covariance
from fleetpose.pose_server.mapping.located import PlacedView, map_of_views
from fleetpose.pose_server.mapping.scene import MapCamera, MapLink, Scene, corners_of
from fleetpose.pose_server.pose_graph.types import FleetSolution
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Verdict, ViewName

if TYPE_CHECKING:
    from fleetpose.pose_server.state.views import KeptView


def ring_scene(
    ring: Ring,
    answers: Mapping[Pair, ClickedAnswer],
    wires: Mapping[int, Path],
    depth_m: float,
    seed: int = 0,
) -> Scene:
    """The robots of a ring that the solver joins to the anchor of the largest arc; they are named
    after their views' places in the recording. The frame is the anchor's body: z is up if its
    camera looks ahead.

    Args:
        answers: of the ring's pairs.
        wires: what the robots sent, by index of their views.
        depth_m: median depth of the scene.
        seed: of names and order.
    """
    views = {view.index: view for view in ring.views}
    names, solution = solution_of(views, answers, depth_m, seed, covariances=True)
    largest = max(connected(answers), key=len)
    anchor = min(largest, key=lambda index: str(names[index]))
    joined = [i for i in views if solution.joined(names[anchor], names[i])]
    placed = [
        _placed(solution, names, anchor, number, index, kept(wires[index]))
        for number, index in enumerate(joined)
    ]
    at = {index: view.T_fleet_camera[:3, 3] for index, view in zip(joined, placed, strict=True)}
    return Scene(
        map_of_views(placed, [str(index) for index in joined], depth_m),
        tuple(_cameras(placed)),
        tuple(
            MapLink(at[a], at[b], _verdict(answers[a, b].answer.verdict), False)
            for a, b in answers
            if _is_used(solution, names[a], names[b]) and a in at and b in at
        ),
        tuple(str(index) for index in views if index not in at),
    )


def _placed(
    solution: FleetSolution,
    names: Mapping[int, ViewName],
    anchor: int,
    number: int,
    index: int,
    view: "KeptView",
) -> PlacedView:
    relative = solution.relative(names[anchor], names[index])
    assert relative is not None  # it is joined
    T = ROBOT_FROM_CAMERA @ relative.T_a_b
    C = np.zeros((6, 6)) if relative.covariance is None else relative.covariance
    return PlacedView(number, view, T, position_covariance(T, in_fleet(ROBOT_FROM_CAMERA, C)))


def _cameras(placed: list[PlacedView]) -> Iterator[MapCamera]:
    for view in placed:
        path = view.T_fleet_camera[None, :3, 3]
        corners = corners_of(view.kept.camera)
        yield MapCamera(view.robot, view.T_fleet_camera, view.covariance, corners, path)


def _verdict(said: str) -> Verdict:
    """Of a link that is used."""
    return "verified" if said == "verified" else "plausible"


def _is_used(solution: FleetSolution, a: ViewName, b: ViewName) -> bool:
    judged = solution.edges.get((a, b, "pair"))
    return judged is not None and judged.weight > 0.0
