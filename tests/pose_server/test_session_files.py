"""A session leaves as files and comes back; what cannot come back is named."""

import csv
import json
import tempfile
from pathlib import Path

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.formats.g2o import read_g2o
from fleetpose.formats.tum import tum_line
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.correspondences.records import JournalError
from fleetpose.pose_server.correspondences.store import CorrespondenceStore, Kept
from fleetpose.pose_server.frontend.frames import body_pose
from fleetpose.pose_server.persistence.export import ExportError, export
from fleetpose.pose_server.persistence.graph_store import Graph, GraphStore
from fleetpose.pose_server.persistence.graph_writer import graph_of
from fleetpose.pose_server.persistence.importing import import_files
from fleetpose.pose_server.persistence.restore import folder_files
from fleetpose.pose_server.persistence.table import (
    COLUMNS,
    TableError,
    read_rows,
    write_csv,
    write_json,
)
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import Correspondence, ViewName
from tests.pose_server.scene import EPOCH, turned
from tests.pose_server.test_flows import click, kept, scene_with_points_to_click, work_off

T_TRUE = turned(15)


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """The state folder of a server that has ended: two views, aligned, with three clicks."""
    state = tmp_path_factory.mktemp("session") / "state"
    messages, points = scene_with_points_to_click(np.random.default_rng(4), T_TRUE)
    journal_file, graph_file = folder_files(state)
    with Journal(journal_file) as journal:
        site = Site(correspondences=CorrespondenceStore(journal))
        for message in messages:
            pipeline.receive_token(site, message.name.robot, EPOCH, True)
            pipeline.receive_view(site, kept(message))
        work_off(site)
        for n, point in enumerate(points, 1):
            (outcome,) = pipeline.receive_update(site, click(n, point, T_TRUE))
            assert outcome.accepted, outcome.reason
        work_off(site)
        store = GraphStore(graph_file)
        store.write(Graph(), graph_of(site))
        store.close()
        journal.note(anchor=site.anchor)
    return state


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_session_is_written_in_the_formats_that_others_read(session, tmp_path):
    written = export(session, tmp_path)
    assert (written.correspondences, written.keyframes, written.components) == (3, 2, 1)
    assert [row["robot_j"] for row in rows(tmp_path / "correspondences.csv")] == ["r2"] * 3
    items = json.loads((tmp_path / "correspondences.json").read_text())["correspondences"]
    assert {item["status"] for item in items} == {"accepted"}
    assert all(0 < item["z_m_i"] < 20 for item in items)

    graph, values = gtsam.readG2o(str(tmp_path / "fleet.g2o"), True)
    vertex = {row["robot"]: int(row["vertex"]) for row in rows(tmp_path / "vertices.csv")}
    assert values.size() == 2 and graph.size() == written.links >= 1
    T = values.atPose3(vertex["r1"]).between(values.atPose3(vertex["r2"])).matrix()
    assert np.linalg.norm(T[:3, 3] - T_TRUE[:3, 3]) < 0.1
    assert graph.error(values) < 20  # gtsam takes rotations four times too exactly

    (component,) = (tmp_path / "tum").iterdir()
    poses = {path.stem: np.loadtxt(path).reshape(-1, 8) for path in component.glob("*.tum")}
    assert poses.keys() == {"r1", "r2"} and component.name == "r1"
    apart = np.linalg.norm(poses["r2"][0, 1:4] - poses["r1"][0, 1:4])
    assert apart == pytest.approx(np.linalg.norm(T[:3, 3]), abs=1e-5)
    assert np.allclose(np.linalg.norm(poses["r2"][:, 4:], axis=1), 1.0)


def test_information_matrices_survive_the_order_of_g2o(session, tmp_path):
    export(session, tmp_path)
    graph, _ = gtsam.readG2o(str(tmp_path / "fleet.g2o"), True)
    edge = read_g2o(tmp_path / "fleet.g2o").edges[0]
    angles = np.repeat((2.0, 1.0), 3)  # gtsam reads half angles as whole ones
    read = graph.at(0).noiseModel().information()
    assert np.allclose(edge.information * np.outer(angles, angles), read, rtol=1e-3)
    assert np.diag(edge.information)[:3].max() > np.diag(edge.information)[3:].max()


def test_what_was_exported_is_imported_into_an_empty_session_and_no_second_time(session, tmp_path):
    export(session, tmp_path / "out")
    assert import_files(tmp_path / "state", [tmp_path / "out"]).accepted == 3
    again = import_files(tmp_path / "state", [tmp_path / "out" / "correspondences.csv"])
    assert (again.accepted, again.duplicates, again.refused) == (0, 3, [])
    export(tmp_path / "state", tmp_path / "back")
    for a, b in zip(
        *(rows(tmp_path / name / "correspondences.csv") for name in ("out", "back")), strict=True
    ):
        same = [c for c in COLUMNS if c not in ("status", "residual_m", "residual_px")]
        assert [a[c] for c in same] == [b[c] for c in same]
        # the images of the new session's views were not asked yet
        assert (a["status"], b["status"]) == ("accepted", "unused")


def test_each_row_that_cannot_be_taken_is_named(session, tmp_path):
    export(session, tmp_path)
    lines = (tmp_path / "correspondences.csv").read_text().splitlines()
    place = {column: k for k, column in enumerate(COLUMNS)}

    def spoiled(**values: str) -> str:
        cells = lines[1].split(",")
        for column, value in values.items():
            cells[place[column]] = value
        return ",".join(cells)

    bad = tmp_path / "bad.csv"
    spoilt = (spoiled(u_i="left"), spoiled(u_i="9000"), spoiled(seq_i="77"), spoiled(robot_j="r1"))
    bad.write_text("\n".join((lines[0], *spoilt, lines[2], "")))
    found = import_files(tmp_path / "state", [bad])
    assert found.accepted == 1
    reasons = dict(found.refused)
    assert "u_i" in reasons["bad.csv, line 2"] and "number" in reasons["bad.csv, line 2"]
    assert "outside" in reasons["bad.csv, line 3"]
    assert (
        "not kept" in reasons["bad.csv, line 4"] or "not both known" in reasons["bad.csv, line 4"]
    )
    assert len(reasons) == 4


def test_files_without_correspondences_and_folders_without_a_session_are_refused(tmp_path):
    (tmp_path / "a.json").write_text("{}")
    (tmp_path / "b.csv").write_text("time,x\n1,2\n")
    (tmp_path / "c.json").write_text("[" * 100_000)
    for name in ("a.json", "b.csv", "c.json", "none.csv"):
        with pytest.raises(TableError):
            import_files(tmp_path / "state", [tmp_path / name])
    assert not (tmp_path / "state").exists()  # nothing was begun
    with pytest.raises(ExportError, match="state-dir"):
        export(tmp_path / "state", tmp_path / "out")
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "journal.sqlite3").write_bytes(b"no journal" * 1000)
    with pytest.raises(ExportError, match="cannot be read"):
        export(tmp_path / "state", tmp_path / "out")


def test_a_running_server_may_be_exported_but_not_imported_into(session, tmp_path):
    export(session, tmp_path / "out")
    journal_file, _ = folder_files(session)
    with Journal(journal_file):
        assert export(session, tmp_path / "again").correspondences == 3
        with pytest.raises(JournalError, match="in use by process"):
            import_files(session, [tmp_path / "out"])


NAMES = st.from_regex(r"[a-z0-9_-]{1,12}", fullmatch=True)
PIXELS = st.tuples(*2 * [st.floats(-1e4, 1e4)]).map(np.array)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(NAMES, NAMES, NAMES, PIXELS, PIXELS), max_size=5), st.booleans())
def test_every_correspondence_is_read_as_it_was_written(items, as_json):
    written = [
        Kept(
            Correspondence(
                id=number,
                operator=operator,
                view_i=ViewName(robot=a, epoch=EPOCH, seq=number),
                view_j=ViewName(robot=b, epoch=EPOCH, seq=3),
                pixel_i=pixel_i,
                pixel_j=pixel_j,
            ),
            np.zeros(3),
            np.eye(3),
            np.ones(3),
            np.eye(3),
        )
        for number, (operator, a, b, pixel_i, pixel_j) in enumerate(items)
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("x.json" if as_json else "x.csv")
        (write_json if as_json else write_csv)(path, written)
        read = [row.click for row in read_rows(path)]
    assert len(read) == len(written)
    for kept_one, one in zip(written, read, strict=True):
        item, ends = kept_one.item, dict(one.ends)
        assert one.operator == item.operator
        if item.view_i != item.view_j:
            assert ends[item.view_i] == tuple(item.pixel_i)
            assert ends[item.view_j] == tuple(item.pixel_j)


def test_a_line_of_a_trajectory_has_all_digits_of_its_time_and_a_pose_that_comes_back():
    T = body_pose(np.eye(4), T_TRUE, np.eye(4))
    cells = tum_line(1_700_000_000_123_456_789, T).split()
    assert cells[0] == "1700000000.123456789" and len(cells) == 8
    x, y, z, qx, qy, qz, qw = map(float, cells[1:])
    R = gtsam.Rot3.Quaternion(qw, qx, qy, qz).matrix()
    assert np.allclose(R, T[:3, :3], atol=1e-7) and np.allclose((x, y, z), T[:3, 3], atol=1e-8)


def test_views_named_in_a_file_are_taken_from_beside_it_only(session, tmp_path):
    export(session, tmp_path / "out")
    for path in (tmp_path / "out" / "views").glob(f"r2_{EPOCH}_*"):
        path.write_bytes(b"damaged")
    found = import_files(tmp_path / "state", [tmp_path / "out"])
    assert found.accepted == 0 and len(found.refused) == 3
    assert all("cannot be read" in reason for _, reason in found.refused)
