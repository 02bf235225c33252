"""Updates that were not receipted outlive the client."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.outbox import Outbox
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol.codec import pack
from fleetpose.protocol.messages import Receipts, Rejection, ViewName

PAIR = ("r1", "r2")
EPOCH = "5" * 12


def places(k):
    view_i, view_j = (ViewName(robot=robot, epoch="0" * 12, seq=1) for robot in PAIR)
    pixels = {"pixel_i": (float(k), 1.0), "pixel_j": (2.0, 3.0)}
    return {"view_i": view_i, "view_j": view_j, **pixels}


def receipts(box, n, *rejected, server=EPOCH):
    rejections = tuple(Rejection(n=k, reason="no") for k in rejected)
    return Receipts(
        operator=box.operator, session=box.session, server_epoch=server, n=n, rejections=rejections
    )


@pytest.fixture
def file(tmp_path):
    return tmp_path / "state" / "updates.sqlite"


def reopened(kept, file):
    kept.close()
    again = UpdateLog(file)
    return again, Outbox("anna", kept=again)


def test_what_is_open_is_offered_again_under_its_number(file):
    kept = UpdateLog(file)
    box = Outbox("anna", kept=kept)
    updates = [box.post("add", PAIR, 0, **places(k)).update for k in range(5)]
    box.settle(receipts(box, 2))
    kept, again = reopened(kept, file)
    assert again.session == box.session
    assert [pack(ticket.update) for ticket in again.sendable] == [pack(u) for u in updates[2:]]
    assert again.post("add", PAIR, 0, **places(9)).update.n == 6
    settled = again.settle(receipts(again, 6, 4))
    assert [ticket.reason for ticket in settled] == [None, "no", None, None]
    assert reopened(kept, file)[1].open == ()


def test_a_clear_that_was_held_is_gone_and_leaves_no_gap(file):
    kept = UpdateLog(file)
    box = Outbox("anna", kept=kept)
    box.post("add", PAIR, 0, **places(0))
    box.post("clear", PAIR, 0, held=True)
    box.post("add", PAIR, 0, **places(1))
    kept, again = reopened(kept, file)
    assert [(t.update.action, t.update.n) for t in again.sendable] == [("add", 1), ("add", 2)]
    assert [t.update.n for t in reopened(kept, file)[1].sendable] == [1, 2]


def test_a_clear_that_was_let_go_is_kept(file):
    kept = UpdateLog(file)
    box = Outbox("anna", kept=kept)
    ticket = box.post("clear", PAIR, 7, held=True)
    ticket.held = False
    box.keep(ticket)
    (found,) = reopened(kept, file)[1].open
    assert (found.update.action, found.update.n, found.update.base_revision) == ("clear", 1, 7)


def test_a_late_receipt_does_not_look_like_a_lost_journal_after_a_restart(file):
    kept = UpdateLog(file)
    box = Outbox("anna", kept=kept)
    for k in range(4):
        box.post("add", PAIR, 0, **places(k))
    box.settle(receipts(box, 3))
    kept, again = reopened(kept, file)
    assert not again.is_forgotten_by(receipts(again, 1))
    assert again.is_forgotten_by(receipts(again, 1, server="6" * 12))
    again.restart()
    assert reopened(kept, file)[1].session == again.session != box.session


def test_two_clients_do_not_share_a_file(file):
    kept = UpdateLog(file)
    with pytest.raises(OperatorError, match="cannot be used"):
        UpdateLog(file)
    kept.close()
    UpdateLog(file).close()


def test_a_file_that_is_none_is_said(file):
    file.parent.mkdir()
    file.write_bytes(b"something else" * 100)
    with pytest.raises(OperatorError, match="cannot be used"):
        UpdateLog(file)


_CHILD = """
import os, signal, sys
from pathlib import Path
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.hmi_client.model.session import OperatorSession
from tests.hmi_client.test_kept import places
session = OperatorSession("anna", kept=UpdateLog(Path(sys.argv[1])))
for k in range(20):
    p = places(k)
    session.add(p["view_i"], p["pixel_i"], p["view_j"], p["pixel_j"])
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_client_that_is_killed_has_every_click(file):
    root = Path(__file__).resolve().parents[2]
    ended = subprocess.run([sys.executable, "-c", _CHILD, str(file)], cwd=root, check=False)
    assert ended.returncode == -signal.SIGKILL
    session = OperatorSession("anna", kept=UpdateLog(file))
    assert [update.n for update in session.open_updates()] == list(range(1, 21))
    assert [update.pixel_i[0] for update in session.open_updates()] == list(range(20))
