"""`pose-eval ablate`: numbers and stages are changed where pairs are aligned, and named if not."""

import json

import pytest

from fleetpose.evaluation.bench.ablate import STAGES, changes_of, run, scaled
from fleetpose.evaluation.options.recorded import AblateOptions
from fleetpose.pose_server.tuned import tuned
from fleetpose.protocol.errors import FleetPoseError
from tests.data import shared_data


def test_a_group_is_all_of_its_numbers_less_and_more():
    changes = changes_of(["words"], 0.2)
    numbers = [name for name in tuned() if name.startswith("words.")]
    assert len(changes) == 1 + 2 * len(numbers)
    for name in numbers:
        less, more = (one[name] for (what, _), one in changes.items() if what == name)
        assert less < tuned()[name] < more and type(less) is type(tuned()[name])


def test_without_names_everything_is_tried():
    changes = changes_of([], 0.2)
    assert {name for name, _ in changes} > set(STAGES) and len(changes) > 300


def test_every_stage_names_numbers_that_are():
    known = changes_of([], 0.2) and tuned()
    for changes in STAGES.values():
        assert all(name in known for name in changes if "." in name)


@pytest.mark.parametrize("name", ["nothing", "words.nothing", "pair.ratio=much", "rivals=3"])
def test_what_is_no_number_is_named(name):
    with pytest.raises(FleetPoseError, match=name.split("=")[0]):
        changes_of([name], 0.2)


def test_a_whole_number_changes_at_least_by_one():
    assert (scaled(2, 0.8), scaled(2, 1.2), scaled(10, 1.2)) == (1, 3, 12)
    assert scaled(0.5, 0.8) == pytest.approx(0.4)


def test_what_is_changed_shows_and_the_rest_is_as_it_was(tmp_path):
    church = shared_data("church_herzjesu")
    options = AblateOptions(church, "sparse_noisy", limit=2, workers=1)
    run(options, ["words.least_exact=100000", "rivals", "words.least_inliers=8"], tmp_path / "out")
    effects = json.loads((tmp_path / "out" / "summary.json").read_text())["effects"]
    before, strict, _, same = effects
    assert before["verified"] > 0 and strict["verified"] == 0 and strict["right"] == before["right"]
    assert same["verified"] == before["verified"]
