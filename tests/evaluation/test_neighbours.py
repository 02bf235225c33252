"""The bench of the index: its truth is of places, and it counts what is found of it."""

from fleetpose.evaluation.bench.scale import neighbours
from fleetpose.evaluation.options.fleets import NeighboursOptions


def test_neighbours_of_small_towns_are_found(tmp_path):
    summary = neighbours.run(NeighboursOptions(robots=10, town=8), tmp_path)
    # rings of 8: 45 deg apart, nobody is within 30 deg of another
    assert summary["towns"] == 2 and summary["true_neighbours"] == 0
    summary = neighbours.run(NeighboursOptions(robots=16, town=16), tmp_path)
    # 22.5 deg apart: one on each side, and each pair counts once
    assert summary["true_neighbours"] == 16 and summary["found_share"] == 1.0
    assert (tmp_path / "neighbours.csv").read_text().count("\n") == 17
