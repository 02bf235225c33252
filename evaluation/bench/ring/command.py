"""`pose-eval ring`: the paper's Figs. 9 and 10 on rings of posed views."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.clicks.click_noise import wrong_of
from fleetpose.evaluation.bench.clicks.rows import ClickRow, click_row, named
from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.bench.clicks.worker import ClickedAnswer, Plan, Recipe, Task, run_task
from fleetpose.evaluation.bench.ring.layout import Ring, rings_of
from fleetpose.evaluation.bench.ring.report import RingRow, ring_row, write_results, write_summaries
from fleetpose.evaluation.bench.ring.scene import ring_scene
from fleetpose.evaluation.bench.ring.solving import Pair, Solved, solve_ring
from fleetpose.evaluation.bench.working import Bench, bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import TrueView, shared_tracks
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.options.recorded import RingOptions
from fleetpose.evaluation.report.output import output_folder
from fleetpose.pose_server.mapping.scene import Scene
from fleetpose.protocol.errors import FleetPoseError

Answers = dict[tuple[Pair, int, int], ClickedAnswer]
"""By pair, number of clicks and draw."""


def run(options: RingOptions, out: Path) -> dict[str, Any]:
    """Aligns all neighbours of all rings, solves each ring's fleet, writes the results.

    Returns:
        The summary; with both recipes, theirs by name.

    Raises:
        FleetPoseError: the data cannot be used, or the folder cannot be made.
    """
    if not options.clicks or min(options.clicks) < 0:
        raise FleetPoseError("--clicks: give numbers from 0 on, e.g. 0,3")
    recording = options.recording()
    rings = rings_of(recording, options.starts)
    output_folder(out)
    depth_m = median_depth_m(recording)
    pairs = {(i.index, j.index): (i, j) for same in rings for ring in same for i, j in ring.pairs}
    true = {pair: true_pixels(recording, *views) for pair, views in pairs.items()}
    shared = {pair: shared_tracks(recording, *views) for pair, views in pairs.items()}
    recipes: tuple[Recipe, ...] = (
        ("paper", "full") if options.recipe == "both" else (options.recipe,)
    )
    summaries: dict[str, dict[str, Any]] = {}
    with bench_of(options.workers) as bench:
        wires, _ = bench.on_the_wire(recording, [view for both in pairs.values() for view in both])
        for recipe in recipes:
            tasks = _tasks(options, recipe, wires, true)
            answers = _answers(list(tasks), bench, recipe)
            solved = list(_solved(rings, answers, depth_m, options, bench, recipe))
            limits = Limits.of(depth_m, recording.is_rgbd)
            rows = {
                key: click_row(pairs[key[0]], *key[1:], clicked, limits, shared[key[0]])
                for key, clicked in answers.items()
            }
            for _, key, fleet in solved:
                _note_named(rows, answers, key, fleet)
            table = _table(rings, solved, rows, options)
            place = out if len(recipes) == 1 else output_folder(out / recipe)
            if recipe == "full" and 0 in options.clicks:
                own = {pair: answers[pair, 0, 0] for pair in _indices(rings[0][0].pairs)}
                scene = ring_scene(rings[0][0], own, wires, depth_m, options.seed)
                _draw(scene, rings[0][0], place / "fleet3d.png")
            summaries[recipe] = write_results(place, recipe, table, list(rows.values()), depth_m)
    return write_summaries(out, summaries)


def _draw(scene: Scene, ring: Ring, path: Path) -> None:
    from fleetpose.pose_server.mapping.picture import draw  # matplotlib takes a while

    draw(scene, path, f"neighbours {ring.separation_deg:.3g} deg apart, no clicks")


def _tasks(
    options: RingOptions,
    recipe: Recipe,
    wires: dict[int, Path],
    true: dict[Pair, Any],
) -> Iterator[tuple[tuple[Pair, int], Task]]:
    for pair in sorted(true):
        for draw in range(options.draws):
            plans = tuple(
                Plan(clicks, wrong_of(clicks, options.wrong_share))
                for clicks in options.clicks
                if draw < options.draws_of(clicks)
            )
            if plans:
                seed = (options.seed, *pair, draw)
                wire_i, wire_j = wires[pair[0]], wires[pair[1]]
                yield (pair, draw), Task(wire_i, wire_j, true[pair], plans, recipe, seed)


def _answers(
    tasks: Sequence[tuple[tuple[Pair, int], Task]], bench: Bench, recipe: Recipe
) -> Answers:
    plans = {label: task.plans for label, task in tasks}
    answers: Answers = {}
    jobs = [(label, (run_task, task)) for label, task in tasks]
    for (pair, draw), clicked in bench.as_done(f"{recipe}: draws", jobs):
        for plan, one in zip(plans[pair, draw], clicked, strict=True):
            answers[pair, plan.clicks, draw] = one
    return dict(sorted(answers.items()))


def _solved(
    rings: Sequence[Sequence[Ring]],
    answers: Answers,
    depth_m: float,
    options: RingOptions,
    bench: Bench,
    recipe: Recipe,
) -> Iterator[tuple[Ring, tuple[int, int], Solved]]:
    """Every ring with every draw of every number of clicks."""
    jobs = []
    for ring in (ring for same in rings for ring in same):
        views = {view.index: view for view in ring.views}
        for clicks in options.clicks:
            for draw in range(options.draws_of(clicks)):
                own = {pair: answers[pair, clicks, draw] for pair in _indices(ring.pairs)}
                job = (solve_ring, views, own, depth_m, options.seed + draw)
                jobs.append(((ring, (clicks, draw)), job))
    for (ring, key), solved in bench.as_done(f"{recipe}: fleets", jobs):
        yield ring, key, solved


def _indices(pairs: Sequence[tuple[TrueView, TrueView]]) -> list[Pair]:
    return [(i.index, j.index) for i, j in pairs]


def _note_named(
    rows: dict[tuple[Pair, int, int], ClickRow],
    answers: Answers,
    key: tuple[int, int],
    fleet: Solved,
) -> None:
    for pair, marked in fleet.marked.items():
        rows[pair, *key].named = named(answers[pair, *key], marked)


def _table(
    rings: Sequence[Sequence[Ring]],
    solved: Sequence[tuple[Ring, tuple[int, int], Solved]],
    rows: dict[tuple[Pair, int, int], ClickRow],
    options: RingOptions,
) -> list[RingRow]:
    table = []
    for same in rings:
        for clicks in options.clicks:
            fleets = [one for ring, key, one in solved if ring in same and key[0] == clicks]
            pairs = {pair for ring in same for pair in _indices(ring.pairs)}
            own = [row for (pair, n, _), row in rows.items() if n == clicks and pair in pairs]
            table.append(ring_row(same, clicks, fleets, own))
    return table
