"""What a soak says of memory, and a short soak of live processes."""

import csv

import pytest

from fleetpose.evaluation.options.fleets import SoakOptions
from fleetpose.evaluation.system.soak import command
from fleetpose.evaluation.system.soak.report import Second, Trouble, slope_mb_per_min


def second(at_s: float, mb: float) -> Second:
    return Second(at_s, 3, 0, mb, 50.0, 50.0, 50.0, 0.1, 0)


def test_growth_is_that_of_the_longest_stretch_that_nobody_touched_once_caches_are_full():
    filling = [second(t, 100.0 + t) for t in range(120)]
    growing = [second(t, 220.0 + 0.05 * (t - 120)) for t in range(120, 900)]
    again = [second(t, 50.0 + 3.0 * (t - 900)) for t in range(900, 1000)]
    troubles = [Trouble(900.0, "killed", "server", 5.0), Trouble(400.0, "killed", "r2", 1.0)]
    seconds = filling + growing + again
    assert slope_mb_per_min(seconds, troubles, "server") == pytest.approx(3.0)
    assert slope_mb_per_min(seconds, troubles, "robots") == pytest.approx(0.0, abs=1e-9)
    assert slope_mb_per_min(seconds[:150], [], "server") is None


@pytest.mark.timeout(300)
def test_a_short_soak_loses_nothing_and_leaves_its_tables(tmp_path):
    options = SoakOptions(hours=20 / 3600, robots=3, trouble_s=6.0)
    summary = command.run(options, tmp_path)
    assert summary["killed"] + summary["frozen"] >= 1
    assert (summary["lost"], summary["doubled"], summary["grave_located"]) == (0, 0, 0)
    assert summary["settled"] and summary["receipted"] > 0
    with (tmp_path / "seconds.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 5 and float(rows[-1]["server_mb"]) > 0
    assert (tmp_path / "soak.png").stat().st_size > 10_000
