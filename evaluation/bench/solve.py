"""`pose-eval solve`: the fleet's solver alone, on a made-up fleet with wrong edges or on a recorded
pose graph.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.pairs.worker import timed
from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.options.recorded import SolveOptions
from fleetpose.evaluation.report.output import output_folder, plot, progress_bar, write_summary
from fleetpose.pose_server.geometry.se3 import adjoint, exp_so3, make_pose
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.types import Edge, FleetSolution, SolveSettings
from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from fleetpose.protocol.messages import ViewName

EPOCH = "0" * 12
AREA_M = 40.0  # robots stand anywhere in a square of this side
HEIGHT_M = 1.0
SIGMA_RAD, SIGMA_M = 0.01, 0.05  # of right edges
AT_FIRST = 0.5  # of the edges are there when the updates begin
NEAR = 12  # robots that one may share an edge with


@dataclass(frozen=True)
class MadeUp:
    """A fleet whose poses are known; `wrong` are places among the edges."""

    nodes: list[ViewName]
    truth: list[Floats]
    edges: list[Edge]
    wrong: frozenset[int]


def run(options: SolveOptions, out: Path) -> dict[str, Any]:
    """Solves a made-up fleet; writes summary.json and map.png.

    Raises:
        FleetPoseError: there are too few or too many edges for the robots.
    """
    robots, edges = options.robots, options.edges
    if not robots - 1 <= edges <= robots * min(NEAR, robots - 1) // 2:
        most = robots * min(NEAR, robots - 1) // 2
        raise FleetPoseError(f"--edges {edges}: {robots} robots have from {robots - 1} to {most}")
    fleet = make_up(robots, edges, options.wrong, np.random.default_rng(options.seed))
    _, scratch_ms = timed(lambda: _solved(fleet, range(edges), None))
    first = max(int(AT_FIRST * edges), 1)
    solution = _solved(fleet, range(first), None)
    updates_ms = []
    with progress_bar() as progress:
        for count in progress.track(range(first + 1, edges + 1), description="updates"):
            began = time.perf_counter()
            solution = _solved(fleet, range(count), solution)
            updates_ms.append(1e3 * (time.perf_counter() - began))
    clean = _solved(fleet, [k for k in range(edges) if k not in fleet.wrong], None)
    found = {k for k, edge in enumerate(fleet.edges) if solution.edges[edge.key].outlier}
    error, clean_error = mean_error_m(fleet, solution), mean_error_m(fleet, clean)
    summary = {
        "robots": robots,
        "edges": edges,
        "wrong": len(fleet.wrong),
        "seed": options.seed,
        "update_ms_p50": percentile(updates_ms, 50),
        "update_ms_p95": percentile(updates_ms, 95),
        "update_ms_max": max(updates_ms),
        "scratch_ms": scratch_ms,
        "error_m": error,
        "clean_error_m": clean_error,
        "error_vs_clean": error / clean_error,
        "wrong_found": len(found & fleet.wrong),
        "right_refused": len(found - fleet.wrong),
        "located": len(located(fleet, solution)),
    }
    write_summary(output_folder(out), summary, "solve")
    return summary


def make_up(robots: int, count: int, wrong_share: float, rng: np.random.Generator) -> MadeUp:
    """Robots at random places; edges between near ones, as verified alignments would give them.

    A tree of right edges holds all together; of the others a share is wrong: of a random pose, as
    sure of itself as the right ones.
    """
    nodes = [ViewName(robot=f"r{k}", epoch=EPOCH, seq=0) for k in range(robots)]
    places = rng.uniform(-1, 1, (robots, 3)) * (AREA_M / 2, AREA_M / 2, HEIGHT_M / 2)
    truth: list[Floats] = [
        np.asarray(make_pose(exp_so3(np.array([0.0, 0.0, turn])), t), np.float64)
        for t, turn in zip(places, rng.uniform(-np.pi, np.pi, robots), strict=True)
    ]
    pairs = _tree(places) + _near_pairs(places, rng)
    pairs = list(dict.fromkeys(pairs))[:count]
    others = np.arange(robots - 1, len(pairs))
    wrong = set(rng.choice(others, min(round(wrong_share * count), len(others)), replace=False))
    order = rng.permutation(len(pairs))
    edges = [_edge(nodes, truth, pairs[k], k in wrong, rng) for k in order]
    return MadeUp(nodes, truth, edges, frozenset(n for n, k in enumerate(order) if k in wrong))


def mean_error_m(fleet: MadeUp, solution: FleetSolution) -> float:
    """Mean position error of all robots located beside the first, which is the gauge."""
    T_first_world, known = inverse(fleet.truth[0]), located(fleet, solution)
    errors = [
        np.linalg.norm(solution.nodes[node].T_root_camera[:3, 3] - (T_first_world @ T)[:3, 3])
        for node, T in zip(fleet.nodes, fleet.truth, strict=True)
        if node in known
    ]
    return float(np.mean(errors))


def located(fleet: MadeUp, solution: FleetSolution) -> set[ViewName]:
    """Robots joined to the first by what nothing else contradicts."""
    return {
        node
        for node in solution.components[fleet.nodes[0]]
        if solution.nodes[node].verdict != "ambiguous"
    }


def run_recorded(path: Path, out: Path) -> dict[str, Any]:
    """Loads and solves a recorded pose graph of several robots; writes summary.json and map.png.

    Args:
        path: a g2o file, or a folder with one per robot.
        out: folder for the results.

    Raises:
        DataFolderError: there is no such graph.
    """
    began = time.perf_counter()
    edges = list(read_g2o(path))
    loaded = time.perf_counter()
    nodes = sorted({v for edge in edges for v in (edge.a, edge.b)}, key=lambda v: (v.robot, v.seq))
    newest = {node.robot: node for node in nodes}
    settings = SolveSettings(0.0, 0.0, agree_translation_m=5.0, distinct_m=1.0)
    solution = solve_fleet(nodes, edges, gauge=nodes[0], newest=newest, settings=settings)
    solved = time.perf_counter()
    between = [edge for edge in edges if edge.a.robot != edge.b.robot]
    judged = [solution.edges[edge.key] for edge in between]
    summary = {
        "robots": len(newest),
        "nodes": len(nodes),
        "edges": len(edges),
        "between_robots": len(between),
        "outliers": sum(one.outlier for one in judged),
        "joined": len(solution.components[nodes[0]]),
        "load_s": loaded - began,
        "solve_s": solved - loaded,
        "chi2_per_dof_median": float(np.median([j.distance2 / 6 for j in judged if j.weight])),
    }
    write_summary(output_folder(out), summary, "solve")
    _plot(out / "map.png", solution, nodes)
    return summary


def read_g2o(path: Path) -> Iterator[Edge]:
    """The edges of a g2o file, or of all in a folder, each once. A key is a robot's letter in the
    highest byte and a number below, as gtsam makes them.

    Raises:
        DataFolderError: there is no such file, or it holds no edges.
    """
    import gtsam

    files = sorted(path.glob("*.g2o")) if path.is_dir() else [path]
    known: set[tuple[int, int]] = set()
    for file in files:
        try:
            graph, _ = gtsam.readG2o(str(file), True)
        except (RuntimeError, ValueError) as error:
            raise DataFolderError(f"{file}: {error}") from error
        for k in range(graph.size()):
            factor = graph.at(k)
            a, b = factor.keys()
            if (a, b) in known:
                continue
            known.add((a, b))
            T = factor.measured().matrix()
            A = adjoint(T)  # gtsam's covariances are of right perturbations
            covariance = A @ factor.noiseModel().covariance() @ A.T
            name_a, name_b = _view(a), _view(b)
            kind = "odometry" if name_a.robot == name_b.robot and b == a + 1 else "pair"
            yield Edge(name_a, name_b, T, covariance, "verified", kind)
    if not known:
        raise DataFolderError(f"{path} holds no pose graph: give a .g2o file, or a folder of them")


def _view(key: int) -> ViewName:
    return ViewName(robot=chr(key >> 56).lower(), epoch=EPOCH, seq=key & (1 << 56) - 1)


def _solved(fleet: MadeUp, which: Sequence[int], previous: FleetSolution | None) -> FleetSolution:
    return solve_fleet(
        fleet.nodes,
        [fleet.edges[k] for k in which],
        gauge=fleet.nodes[0],
        newest={node.robot: node for node in fleet.nodes},
        previous=previous,
        settings=SolveSettings(agree_translation_m=0.5),
    )


def _edge(
    nodes: Sequence[ViewName],
    truth: Sequence[Floats],
    pair: tuple[int, int],
    wrong: bool,
    rng: np.random.Generator,
) -> Edge:
    a, b = pair
    T = inverse(truth[a]) @ truth[b]
    sigmas = np.repeat((SIGMA_RAD, SIGMA_M), 3)
    if wrong:
        T = make_pose(exp_so3(rng.normal(size=3)), rng.uniform(-1, 1, 3) * AREA_M / 4)
    else:
        xi = rng.normal(size=6) * sigmas
        T = make_pose(exp_so3(xi[:3]), xi[3:]) @ T
    return Edge(nodes[a], nodes[b], T, np.diag(sigmas**2), "verified", "pair")


def _tree(places: Floats) -> list[tuple[int, int]]:
    """Each robot with the nearest of those before it."""
    found = []
    for k in range(1, len(places)):
        near = int(np.linalg.norm(places[:k] - places[k], axis=1).argmin())
        found.append((near, k))
    return found


def _near_pairs(places: Floats, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Every robot with those near it, in random order."""
    found = []
    for k, place in enumerate(places):
        near = np.linalg.norm(places - place, axis=1).argsort()[1 : NEAR + 1]
        found += [(min(k, int(m)), max(k, int(m))) for m in near]
    return [found[n] for n in rng.permutation(len(found))]


def _plot(path: Path, solution: FleetSolution, nodes: Sequence[ViewName]) -> None:
    places = np.array([solution.nodes[node].T_root_camera[:3, 3] for node in nodes])
    plane = np.linalg.svd(places - places.mean(0), full_matrices=False)[2][:2]
    xy = (places - places.mean(0)) @ plane.T
    with plot(path, (7.0, 7.0), title="solved pose graph", xlabel="m", aspect="equal") as axes:
        axes.set(ylabel="m")
        for robot in sorted({node.robot for node in nodes}):
            own = [k for k, node in enumerate(nodes) if node.robot == robot]
            axes.plot(*xy[own].T, "-", linewidth=1, label=robot)
