"""The bench of the index: its truth is of places, and it counts what is found of it."""

from fleetpose.evaluation.bench.scale import neighbours
from fleetpose.evaluation.options.fleets import NeighboursOptions


def test_neighbours_of_a_small_town_are_found(tmp_path):
    summary = neighbours.run(NeighboursOptions(robots=16, town=16), tmp_path)
    # 22.5 deg apart: one on each side, and each pair counts once
    assert summary["true_neighbours"] == 16 and summary["found_share"] == 1.0
    assert (tmp_path / "neighbours.csv").read_text().count("\n") == 17
