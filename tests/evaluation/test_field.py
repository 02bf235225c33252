"""The parts of `pose-eval field`, small: how slow or fast anything is is not tested."""

from collections import Counter

import pytest

pytest.importorskip("cryptography", reason="certificates are made with it")

from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.field import command, cost, silent
from fleetpose.evaluation.system.field.attackers.denials import names
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
def test_agent_and_check_name_what_silences_a_robot(tmp_path):
    ways = ("expired", "unknown to the rules", "other name", "no TLS there", "all routers die")
    told = silent.run(FieldOptions(), tmp_path, tmp_path / "out/logs/silent", ways)
    assert told["causes"] == told["agent_tried"] == len(ways)
    assert told["check_named"] == told["agent_named"] == len(ways)


def test_a_plain_site_has_no_security_left(tmp_path):
    plain = cost.Plain(tmp_path)
    for who in ("router/a", "robot/r1"):
        told = plain.configuration(who).read_text()
        assert "tcp/127.0.0.1" in told
        assert not [word for word in ("tls", *cost.SECURITY) if f'"{word}' in told]
