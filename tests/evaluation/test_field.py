"""The parts of `pose-eval field`, small: how slow or fast anything is is not tested."""

import csv
from collections import Counter

import pytest

pytest.importorskip("cryptography", reason="certificates are made with it")

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.field import command
from fleetpose.evaluation.system.field.denials import names
from fleetpose.protocol.errors import FleetPoseError


def test_without_a_part_it_says_which_there_are(tmp_path):
    with pytest.raises(FleetPoseError, match="--attacks"):
        command.run(FieldOptions(), tmp_path)


def test_a_denial_names_who_did_what_with_which_key():
    rows = Counter({("robot/r2", "Declare Queryable (ingress)", "k"): 1})
    assert names(rows, "robot/r2", "answer", "k")
    for who, verb, key in (
        ("r1", "answer", "k"),
        ("robot/r2", "ask", "k"),
        ("robot/r2", "put", "k"),
    ):
        assert not names(rows, who, verb, key)


@pytest.mark.timeout(240)
def test_no_attack_passes_most_are_named_and_nobody_else_is(tmp_path):
    summary = command.run(FieldOptions(attacks=True, quiet_s=4.0), tmp_path)
    assert summary["attacks_tried"] >= 30
    assert summary["attacks_passed"] == summary["attacks_false_alarms"] == 0
    assert summary["attacks_named_share"] > 0.9
    with (tmp_path / "attacks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {"put", "delete", "show", "answer", "listen", "ask"} == {row["verb"] for row in rows}
