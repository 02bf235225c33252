"""The journal: what was receipted is there exactly once, whatever happens."""

import random
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from fleetpose.pose_server.correspondences.journal import Journal, StoredView
from fleetpose.pose_server.correspondences.records import MAX_REJECTIONS, JournalError
from fleetpose.pose_server.correspondences.schema import MIGRATIONS
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.protocol.messages import ImageHeader
from tests.pose_server.correspondence_makers import (
    EPOCH,
    DepthHistory,
    add,
    apply,
    content,
    keeps,
    lift,
    update,
    view,
)
from tests.pose_server.journal_child import encoded, nth

ROOT = Path(__file__).parents[2]


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "state" / "journal.sqlite3"


def test_restart_gives_the_same_book_with_the_points_of_then(path):
    updates = [add(1), add(2, 200.0), add(3, 700.0), add(4, 300.0, i="r3", j="r4")]
    updates += [update("move", 5, 250.0, correspondence=1), update("erase", 6, correspondence=0)]
    with Journal(path) as journal:
        book = CorrespondenceStore(journal)
        apply(book, *updates)
        before, receipts = content(book), book.receipts(add(1), EPOCH)
    with Journal(path) as journal:
        book = CorrespondenceStore(journal)
        assert content(book) == before
        assert book.receipts(add(1), EPOCH) == receipts
        assert apply(book, *updates) == []  # repeated by an operator that missed the receipt
        apply(book, add(7, 400.0))
        assert max(kept.item.id for kept in book.all()) == 3  # ids go on


def test_kill_at_any_moment_loses_and_doubles_nothing_that_was_receipted(path):
    chance = random.Random(0)
    receipted = 0
    for _ in range(6):
        child = subprocess.Popen(
            [sys.executable, "-m", "tests.pose_server.journal_child", str(path)],
            stdout=subprocess.PIPE,
            cwd=ROOT,
            text=True,
        )
        assert child.stdout is not None
        numbers = [int(child.stdout.readline())]
        end = time.monotonic() + chance.uniform(0.0, 0.25)
        while time.monotonic() < end:
            numbers.append(int(child.stdout.readline()))
        child.kill()
        numbers += [
            int(line) for line in child.stdout.read().splitlines(keepends=True) if "\n" in line
        ]
        child.stdout.close()
        assert child.wait(10) == -9
        assert numbers == list(range(numbers[0], numbers[-1] + 1))
        assert numbers[0] in (receipted + 1, receipted + 2)  # one may have lost only its receipt
        receipted = numbers[-1]
        with Journal(path) as journal:
            book = CorrespondenceStore(journal)
            done = book.receipts(nth(1), EPOCH).n
            stored = {kept.name: kept.encoded for kept in journal.views()}
        assert done in (receipted, receipted + 1)
        expected = CorrespondenceStore(DepthHistory())
        apply(expected, *map(nth, range(1, done + 1)))
        assert content(book) == content(expected)
        assert all(stored[name] == encoded(name) for name in book.views())
    assert receipted > 12


def test_two_servers_cannot_share_a_journal_and_the_owner_is_named(path):
    child = subprocess.Popen(
        [sys.executable, "-m", "tests.pose_server.journal_child", str(path)],
        stdout=subprocess.PIPE,
        cwd=ROOT,
        text=True,
    )
    try:
        assert child.stdout is not None
        child.stdout.readline()
        with pytest.raises(JournalError, match=f"in use by process {child.pid}"):
            Journal(path)
    finally:
        child.kill()
        child.communicate()
    Journal(path).close()


def test_full_disk_is_an_error_that_changes_nothing(path):
    with Journal(path) as journal:
        book = CorrespondenceStore(journal)
        apply(book, add(1))
        before = content(book)
        (pages,) = journal._db.execute("PRAGMA page_count").fetchone()
        journal._db.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(JournalError, match=r"full.*nothing was written"):
            book.apply(add(2, 200.0), keeps, lift, lambda name: bytes(50_000))
        assert content(book) == before
        journal._db.execute("PRAGMA max_page_count = 100000")
        assert [o.n for o in book.apply(add(2, 200.0), keeps, lift, lambda name: bytes(9))] == [2]
    with Journal(path) as journal:
        assert len(CorrespondenceStore(journal).all()) == 2


def test_file_held_by_another_program_is_an_error_that_changes_nothing(path, monkeypatch):
    monkeypatch.setattr("fleetpose.pose_server.correspondences.journal._BUSY_TIMEOUT_S", 0.05)
    with Journal(path) as journal:
        book = CorrespondenceStore(journal)
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(JournalError, match="locked"):
            apply(book, add(1))
        assert book.all() == []
        other.execute("ROLLBACK")
        other.close()
        assert apply(book, add(1))[0].accepted


def test_change_out_of_turn_is_refused_whole(path):
    memory = DepthHistory()
    apply(CorrespondenceStore(memory), add(1), add(2, 200.0))
    with Journal(path) as journal:
        with pytest.raises(JournalError, match="does not follow"):
            journal.record(memory.changes[1])
        journal.record(memory.changes[0])
        with pytest.raises(JournalError, match="does not follow"):
            journal.record(memory.changes[0])
        assert len(journal.load().correspondences) == 1


def test_commits_are_synced_to_the_disk(path):
    with Journal(path) as journal:
        for pragma, value in (("journal_mode", "wal"), ("synchronous", 2), ("foreign_keys", 1)):
            assert journal._db.execute(f"PRAGMA {pragma}").fetchone() == (value,)


def test_older_schema_is_brought_up_with_a_copy_and_a_newer_one_refused(path):
    with Journal(path, MIGRATIONS[:1]) as journal:
        assert apply(CorrespondenceStore(journal), add(1), add(2, 200.0))
        journal._db.execute("INSERT INTO poses VALUES ('r1', x'00')")
        before = content(CorrespondenceStore(journal))
    with Journal(path) as journal:
        assert journal._db.execute("PRAGMA user_version").fetchone() == (len(MIGRATIONS),)
        book = CorrespondenceStore(journal)
        assert content(book) == before
        apply(book, add(3, 700.0))
        after = content(book)
    copy = path.with_name("journal.sqlite3.schema1")
    with Journal(copy, MIGRATIONS[:1]) as old:  # for the server of then
        assert content(CorrespondenceStore(old)) == before
        assert old._db.execute("SELECT robot FROM poses").fetchall() == [("r1",)]
    with Journal(path) as journal:
        assert content(CorrespondenceStore(journal)) == after
    newer = (*MIGRATIONS, ("ALTER TABLE pairs ADD COLUMN note TEXT", "CREATE TABLE extra (x) "))
    with Journal(path, newer) as journal:
        assert journal._db.execute("SELECT i, note FROM pairs").fetchall() == [("r1", None)]
    with pytest.raises(JournalError, match=r"schema 3, this server knows 2"):
        Journal(path)


def test_without_room_for_a_copy_an_older_journal_is_not_touched(path):
    with Journal(path, MIGRATIONS[:1]) as journal:
        apply(CorrespondenceStore(journal), add(1))
    copy = path.with_name("journal.sqlite3.schema1")
    copy.with_name(f"{copy.name}.part").mkdir()  # in the way, as a full disk would be
    with pytest.raises(JournalError, match="make room"):
        Journal(path)
    with Journal(path, MIGRATIONS[:1]) as journal:
        assert len(CorrespondenceStore(journal).all()) == 1


def test_failed_migration_leaves_the_old_schema(path):
    with Journal(path) as journal:
        apply(CorrespondenceStore(journal), add(1))
    with pytest.raises(JournalError):
        Journal(path, (*MIGRATIONS, ("CREATE TABLE extra (x)", "NONSENSE")))
    with Journal(path) as journal:
        assert len(CorrespondenceStore(journal).all()) == 1


def test_file_that_is_no_journal_is_refused_untouched(path):
    path.parent.mkdir()
    path.write_bytes(b"my diary" * 1000)
    with pytest.raises(JournalError, match="move it away"):
        Journal(path)
    assert path.read_bytes() == b"my diary" * 1000


def test_damaged_record_is_told_not_swallowed(path):
    with Journal(path) as journal:
        apply(CorrespondenceStore(journal), add(1))
        journal._db.execute("UPDATE correspondences SET p_i = x'00'")
        with pytest.raises(JournalError, match="damaged"):
            CorrespondenceStore(journal)


def test_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalError, match="cannot be made"):
        Journal(tmp_path / "file" / "journal.sqlite3")


def test_only_the_newest_rejections_are_kept(path):
    with Journal(path) as journal:
        book = CorrespondenceStore(journal)
        apply(book, *(add(n, 700.0) for n in range(1, MAX_REJECTIONS + 6)))
        receipts = book.receipts(add(1), EPOCH)
    assert [r.n for r in receipts.rejections] == list(range(6, MAX_REJECTIONS + 6))
    with Journal(path) as journal:
        assert CorrespondenceStore(journal).receipts(add(1), EPOCH) == receipts


def test_views_come_back_and_others_are_dropped(path):
    header = ImageHeader(view=view("r1"), stamp_ns=5, scale=2)
    with Journal(path) as journal:
        journal.keep_view(StoredView(view("r1"), b"cloud"))
        journal.keep_view(StoredView(view("r2"), b"other"))
        journal.keep_view(StoredView(view("r1"), b"cloud", b"jpeg", header))
        journal.keep_view(StoredView(view("r1"), b"cloud"))  # does not take the JPEG away
    with Journal(path) as journal:
        assert journal.view(view("r1")) == StoredView(view("r1"), b"cloud", b"jpeg", header)
        assert journal.view(view("r3")) is None
        assert journal.keep_only_views([view("r1"), view("r9")]) == 1
        assert [stored.name for stored in journal.views()] == [view("r1")]


def test_named_values_come_back(path):
    with Journal(path) as journal:
        journal.note(anchor="r1", gauge_revision="3")
    with Journal(path) as journal:
        assert (journal.noted("anchor"), journal.noted("gauge_revision")) == ("r1", "3")
        assert journal.noted("nothing") is None


class RestartedBook(RuleBasedStateMachine):
    """A book on a real journal, restarted at will, beside one that never stops."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name) / "journal.sqlite3"
        self.journal = Journal(self.path)
        self.book = CorrespondenceStore(self.journal)
        self.steady = CorrespondenceStore(DepthHistory())
        self.n = 0

    def teardown(self) -> None:
        self.journal.close()
        self.folder.cleanup()

    def send(self, one) -> None:
        assert apply(self.book, one) == apply(self.steady, one)

    @rule(column=st.integers(0, 14), pair=st.sampled_from([("r1", "r2"), ("r2", "r3")]))
    def click(self, column, pair):
        self.n += 1
        self.send(add(self.n, 50.0 * column, *pair))

    @rule(
        action=st.sampled_from(["move", "erase"]),
        number=st.integers(0, 6),
        revision=st.integers(0, 2),
    )
    def change(self, action, number, revision):
        self.n += 1
        self.send(
            update(action, self.n, 33.0 * number, correspondence=number, base_revision=revision)
        )

    @rule(revision=st.integers(0, 6))
    def clear(self, revision):
        self.n += 1
        self.send(update("clear", self.n, base_revision=revision))

    @rule(back=st.integers(0, 5))
    def repeat(self, back):
        if self.n > back:
            assert apply(self.book, add(self.n - back, 10.0)) == []

    @rule()
    def restart(self):
        self.journal.close()
        self.journal = Journal(self.path)
        self.book = CorrespondenceStore(self.journal)

    @invariant()
    def both_are_the_same(self):
        assert content(self.book) == content(self.steady)
        assert self.book.receipts(add(1), EPOCH) == self.steady.receipts(add(1), EPOCH)


TestRestartedBook = RestartedBook.TestCase
TestRestartedBook.settings = settings(deadline=None, max_examples=10, stateful_step_count=25)
