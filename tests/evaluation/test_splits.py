"""Reports say whether a place was fitted on."""

from fleetpose.evaluation.bench.pairs.report import write_results
from fleetpose.evaluation.data import splits
from fleetpose.evaluation.data.opening import open_recording
from tests.evaluation.makers import write_posed_views


def test_a_place_is_held_out_unless_something_was_fitted_on_it(tmp_path, monkeypatch):
    monkeypatch.setattr(
        splits,
        "FITTED",
        {"verdict": frozenset({"hall", "plan court"}), "noise": frozenset({"hall"})},
    )
    assert splits.split_of(tmp_path / "hall") == "fitted"
    assert splits.fitted_on("hall") == ["noise", "verdict"]
    assert splits.split_of(tmp_path / "another hall") == "held out"


def test_a_plan_is_known_by_its_source_whatever_its_folder_is_called(tmp_path, monkeypatch):
    monkeypatch.setattr(splits, "FITTED", {"verdict": frozenset({"plan court"})})
    for name, plan in (("a", "court"), ("court", "corridor")):
        (tmp_path / name).mkdir()
        source = f"Made by `pose-eval synth --world {plan} --unique 3 --robots 12 --seed\n1`: ..."
        (tmp_path / name / "SOURCE.txt").write_text(source)
    assert splits.split_of(tmp_path / "a") == "fitted"
    assert splits.place_of(tmp_path / "court") == "plan corridor"
    assert splits.split_of(tmp_path / "court") == "held out"


def test_the_report_of_pairs_names_the_split(tmp_path, monkeypatch, capsys):
    write_posed_views(tmp_path / "set", count=2)
    recording = open_recording(tmp_path / "set", "sparse")
    for places, split in (((), "held out"), (("set",), "fitted")):
        monkeypatch.setattr(splits, "FITTED", {"verdict": frozenset(places)})
        (tmp_path / split).mkdir()
        assert write_results(tmp_path / split, recording, [], 2.0, [1.0])["split"] == split
        assert split in capsys.readouterr().out
