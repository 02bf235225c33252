"""Valid messages with hostile content, and floods of them, do the server no harm."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app.event_queue import EventQueue, Selected, TokenSeen, Updated
from fleetpose.pose_server.app.topics import Publishers
from fleetpose.pose_server.app.view_requests import Fetcher
from fleetpose.pose_server.correspondences.journal import Journal, JournalError, StoredView
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.messages.builders import Stamp
from fleetpose.pose_server.messages.error_matrix import pair_cells
from fleetpose.pose_server.persistence.graph_store import Graph
from fleetpose.pose_server.persistence.restore import restored_site
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state import site as site_module
from fleetpose.pose_server.state.site import MAX_EPOCHS, SiteFullError
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done, EncodedView, PairJob
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.clouds import (
    SalientPoints,
    decode_salient,
    encode_salient,
    encode_scattered,
)
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Camera, OperatorUpdate, Selection, View, ViewName
from fleetpose.protocol.transport import Sample
from tests.pose_server.scene import EPOCH, pair_of_views, turned
from tests.pose_server.test_flows import kept, site_of

KEYS = Keys("demo")
few = settings(max_examples=60, deadline=None)


def good_view(robot: str = "r1", seq: int = 0) -> View:
    one, _ = pair_of_views(np.random.default_rng(0), turned(10.0))
    return one.model_copy(update={"name": ViewName(robot=robot, epoch=EPOCH, seq=seq)})


GOOD = good_view()


def with_salient(view: View, uv: np.ndarray | None = None, width: int | None = None) -> View:
    """The view with other pixels of its salient points, or descriptors of another length."""
    points = decode_salient(view.salient)
    if uv is not None:
        points = replace(points, uv=uv.astype(np.float32))
    if width is not None:
        looks = np.resize(points.descriptors, (len(points.uv), width))
        points = replace(points, descriptors=np.ascontiguousarray(looks))
    return view.model_copy(update={"salient": encode_salient(points)})


def without_salient(view: View) -> View:
    nothing = np.zeros(0, np.float32)
    points = SalientPoints(np.zeros((0, 2), np.float32), nothing, nothing, np.zeros((0, 64), "u1"))
    return view.model_copy(update={"salient": encode_salient(points)})


def with_points(uv: np.ndarray, z: np.ndarray) -> View:
    cloud = encode_scattered(uv, z, 1e-3 * float(np.median(z)))
    return GOOD.model_copy(update={"cloud": cloud})


def opened(view: View):
    return open_view(pack(view), encoding_of(View), 0.0)


# ---- opening a view ------------------------------------------------------------------------------


@few
@given(st.binary(max_size=300))
def test_any_bytes_are_a_codec_error(payload):
    with pytest.raises(CodecError):
        open_view(payload, encoding_of(View), 0.0)


@few
@given(st.data())
def test_a_damaged_view_is_refused_or_a_view_that_workers_take(data):
    payload = bytearray(pack(GOOD))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    try:
        view = open_view(bytes(payload), encoding_of(View), 0.0)
    except CodecError:
        return
    assert np.isfinite(view.median_depth_m) and view.median_depth_m > 0


@pytest.mark.parametrize(
    "view",
    [
        with_points(np.full((20, 2), 5000.0), np.ones(20)),
        with_points(np.full((20, 2), 5.0), np.full(20, 1e6)),
        with_points(np.full((20, 2), 5.0), np.full(20, 1e-6)),
        with_points(np.zeros((3, 2)), np.ones(3)),
        with_salient(GOOD, np.full((len(decode_salient(GOOD.salient).uv), 2), 1e30)),
        with_salient(GOOD, np.full((len(decode_salient(GOOD.salient).uv), 2), -50.0)),
    ],
    ids=["outside", "far", "near", "few", "salient far outside", "salient outside"],
)
def test_a_view_that_no_camera_gives_is_refused(view):
    with pytest.raises(CodecError):
        opened(view)


# ---- two hostile views ---------------------------------------------------------------------------


def other_camera() -> Camera:
    return GOOD.camera.model_copy(update={"K": np.array([[40.0, 0, 9], [0, 90000, 9], [0, 0, 1]])})


@pytest.mark.parametrize(
    "other",
    [
        with_salient(GOOD, width=32),
        with_salient(GOOD, width=1),
        without_salient(GOOD),
        GOOD.model_copy(update={"camera": other_camera()}),
        with_points(np.full((40, 2), 5.0), np.ones(40)),
    ],
    ids=["other descriptors", "one byte descriptors", "no salient points", "camera", "one place"],
)
@pytest.mark.parametrize("robot", ["r1", "r2"])
def test_a_hostile_partner_is_survived_by_server_and_workers(robot, other):
    site = site_of(GOOD)
    name = ViewName(robot=robot, epoch=EPOCH, seq=1)
    other = other.model_copy(update={"name": name})
    pipeline.receive_token(site, robot, EPOCH, True)
    pipeline.receive_view(site, kept(other))
    jobs = 0
    for _ in range(10):
        pipeline.solve(site, 0.0)
        while compare_some(site, 0.0):
            pass
        job = pipeline.next_job(site, 1.0)
        if job is None:
            break
        jobs += 1
        try:
            done = Done(job, run_job(job))
        except Exception as error:  # as the pool hands it over: a worker's error is no death
            done = Done(job, None, str(error))
        pipeline.take_result(site, done, 1.0)
    assert jobs or robot == "r1"  # which is not aligned with itself where no pixel moved
    assert builders.fleet_state(site, ServerSettings(), Stamp(EPOCH, 1.0, 1), 1).robots


@pytest.mark.parametrize("stamp_ns", [2**62 - 1, -(2**62) + 1, 0])
def test_stamps_centuries_off_and_numbers_that_jump_are_published(stamp_ns):
    hostile = good_view(seq=2**63 - 1).model_copy(update={"stamp_ns": stamp_ns})
    site = site_of(hostile)
    pipeline.solve(site, 0.0)
    robot = site.robots["r1"]
    found = builders.robot_pose(site, robot, ServerSettings(), Stamp(EPOCH, 1.0, 1))
    assert found is not None and pack(found[0])
    robot.publish(*found)
    assert pack(builders.fleet_state(site, ServerSettings(), Stamp(EPOCH, 1.0, 1), 1))


def test_an_alignment_that_went_astray_is_no_result(monkeypatch):
    from fleetpose.pose_server.workers import recipes
    from tests.pose_server.test_flows import result

    T = np.eye(4)
    T[0, 3] = np.inf
    monkeypatch.setattr(recipes, "align_pair", lambda *_: result(T))
    encoded = EncodedView(GOOD.name, pack(GOOD))
    with pytest.raises(CodecError, match="finite"):
        run_job(PairJob(encoded, encoded))


# ---- names without end ---------------------------------------------------------------------------


def test_robots_that_only_invent_names_are_bounded_and_gone_ones_make_room(monkeypatch):
    monkeypatch.setattr(site_module, "MAX_ROBOTS", 5)
    site = site_of(GOOD)
    for k in range(4):
        pipeline.receive_token(site, f"ghost-{k}", EPOCH, True)
    with pytest.raises(SiteFullError):
        pipeline.receive_token(site, "late", EPOCH, True)
    pipeline.receive_token(site, "late", EPOCH, False)
    assert len(site.robots) == 5 and "late" not in site.robots
    site.robots["ghost-0"].epochs.clear()  # gone, but it is remembered
    pipeline.receive_token(site, "late", EPOCH, True)
    assert "late" in site.robots and "ghost-0" not in site.robots and "r1" in site.robots


def test_lives_under_one_name_are_bounded():
    site = site_of(GOOD)
    for k in range(1, MAX_EPOCHS):
        pipeline.receive_token(site, "r1", f"{k:012x}"[::-1], True)
    with pytest.raises(SiteFullError):
        pipeline.receive_token(site, "r1", "f" * 12, True)


def test_selections_and_updates_of_invented_robots_leave_nothing():
    site = site_of(GOOD)
    for k in range(50):
        i, j = f"a{k}", f"b{k}"
        views = {
            side: ViewName(robot=robot, epoch=EPOCH, seq=0)
            for side, robot in (("view_i", i), ("view_j", j))
        }
        who = {"operator": "op", "session": EPOCH, "i": i, "j": j}
        pipeline.receive_selection(site, Selection(**who, **views), 0.0)
        for action in ("clear", "erase"):
            update = OperatorUpdate(
                **who,
                n=2 * k + 1 + (action == "erase"),
                action=action,
                base_revision=0,
                correspondence=3,
            )
            (outcome,) = pipeline.receive_update(site, update)
            assert not outcome.accepted and "not both known" in outcome.reason
    assert list(site.robots) == ["r1"] and not site.pairs and not site.correspondences.pairs()


def test_a_thousand_tokens_do_not_slow_the_state():
    site = site_of(GOOD)
    for k in range(900):
        pipeline.receive_token(site, f"ghost-{k}", EPOCH, True)
    asked = []
    site.correspondences.of = lambda a, b: asked.append((a, b)) or []  # type: ignore[method-assign]
    pair_cells(site, 0.0, {})
    assert not asked


class Quiet:
    """Publishers that remember only whether they were closed."""

    def __init__(self) -> None:
        self.closed = False

    def put(self, payload, encoding, attachment=None) -> None:
        assert not self.closed

    def close(self) -> None:
        self.closed = True


def test_publishers_are_bounded_and_the_quietest_goes_first():
    made = {}

    class FakeLink:
        def latched(self, key):
            made[key] = Quiet()
            return made[key]

    publishers = Publishers(FakeLink(), limit=3)  # type: ignore[arg-type]
    for key in ("a", "b", "c", "a", "d"):
        publishers.put(key, GOOD.name)
    assert [key for key, one in made.items() if one.closed] == ["b"]
    assert len(publishers) == 3


# ---- the inbox -----------------------------------------------------------------------------------


@pytest.fixture
def inbox():
    import queue

    store: queue.SimpleQueue[object] = queue.SimpleQueue()
    return EventQueue(KEYS, store, Drops()), store


UPDATE = OperatorUpdate(
    operator="op", session=EPOCH, n=1, action="clear", i="r1", j="r2", base_revision=0
)
SELECTION = Selection(operator="op", session=EPOCH, i="r1", j="r2")


@few
@given(payload=st.binary(max_size=200), encoding=st.text(max_size=50), key=st.text(max_size=50))
def test_whatever_operators_send_is_one_drop_each(payload, encoding, key):
    import queue

    drops, store = Drops(), queue.SimpleQueue()
    inbox = EventQueue(KEYS, store, drops)
    for sent in (
        Sample(KEYS.updates("op"), payload, encoding_of(OperatorUpdate)),
        Sample(KEYS.updates("op"), pack(UPDATE), encoding),
        Sample(key, pack(UPDATE), encoding_of(OperatorUpdate)),
        Sample(KEYS.updates("eve"), pack(UPDATE), encoding_of(OperatorUpdate)),
    ):
        inbox._update(sent)
        inbox._selection(Sample(sent.key, sent.payload, sent.encoding))
    inbox._token(KEYS.robot_alive("r1", "X"), True)
    inbox._token(KEYS.robot_alive("r1", "X"), False)
    assert drops.total() == 9 and store.empty()


def test_good_messages_reach_the_store(inbox):
    box, store = inbox
    box._update(Sample(KEYS.updates("op"), pack(UPDATE), encoding_of(OperatorUpdate)))
    box._selection(Sample(KEYS.selection("op"), pack(SELECTION), encoding_of(Selection)))
    box._token(KEYS.robot_alive("r1", EPOCH), True)
    assert [type(store.get()) for _ in range(3)] == [Updated, Selected, TokenSeen]


def test_a_flood_is_counted_instead_of_kept(inbox, monkeypatch):
    monkeypatch.setattr("fleetpose.pose_server.app.event_queue.MAX_WAITING", 3)
    box, store = inbox
    for _ in range(10):
        box._update(Sample(KEYS.updates("op"), pack(UPDATE), encoding_of(OperatorUpdate)))
    assert store.qsize() == 3 and box._drops.total() == 7


def test_an_answer_that_is_no_view_is_counted():
    drops, fetched = Drops(), []
    sample = Sample("x", b"\xc1", "application/msgpack;fleet.kept_view.v2")
    fetcher = Fetcher(KEYS, lambda *_: sample, fetched.append, drops)
    fetcher._fetch(GOOD.name)
    fetcher.close()
    assert drops == {"not msgpack": 1} and fetched[0].kept is None


# ---- the journal ---------------------------------------------------------------------------------


@few
@given(damage=st.binary(max_size=60), column=st.sampled_from(["view", "header"]))
def test_a_damaged_record_of_the_journal_is_an_error_or_a_view_that_is_left_out(
    tmp_path_factory, damage, column
):
    path = tmp_path_factory.mktemp("journal") / "journal.sqlite3"
    with Journal(path) as journal:
        journal.keep_view(StoredView(GOOD.name, pack(GOOD)))
        journal._db.execute(f"UPDATE views SET {column} = ?", (damage,))
        try:
            site = restored_site(journal, Graph())
        except JournalError as error:
            assert "damaged" in str(error)
            return
        assert GOOD.name not in site.views or column == "header"
