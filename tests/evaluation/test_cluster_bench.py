"""The bench of Dask workers, on a real cluster: all jobs are counted, also with a worker killed."""

import csv
import json

from fleetpose.evaluation.bench.scale import cluster
from fleetpose.evaluation.options.recorded import ClusterOptions
from tests.evaluation.makers import write_posed_views


def test_no_job_is_lost_and_all_are_counted(tmp_path):
    write_posed_views(tmp_path / "set", count=4)
    options = ClusterOptions(tmp_path / "set", "sparse_noisy", workers=(2,), limit=6)
    cluster.run(options, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["runs"][0]["lost"] == 0 and summary["killed_lost"] == 0
    with (tmp_path / "out" / "cluster.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["workers"], row["jobs"], float(row["times_one"])) == ("2", "6", 1.0)
    assert float(row["pairs_per_s"]) > 0


def test_where_more_workers_stop_helping():
    def rates(*per_s: float) -> list[dict[str, float]]:
        return [{"workers": 2**n, "pairs_per_s": rate} for n, rate in enumerate(per_s)]

    assert cluster._stops_at(rates(10.0, 19.0, 36.0)) is None
    assert cluster._stops_at(rates(10.0, 19.0, 21.0)) == 2
