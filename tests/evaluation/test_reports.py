"""What the commands write has the columns and keys that others read."""

import csv
import json
import re

import numpy as np
import pytest

from fleetpose.evaluation.bench.pairs.calls import unsolved
from fleetpose.evaluation.bench.pairs.plots import plot_all, plot_precision_recall
from fleetpose.evaluation.bench.pairs.report import summarize, write_results, write_tables
from fleetpose.evaluation.bench.pairs.row import PairRow
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.report.output import (
    COVARIANCE_COLUMNS,
    OutputFolderError,
    output_folder,
    pose_cells,
    write_summary,
)
from tests.evaluation.makers import pose, write_posed_views, write_rgbd


def row(i=0, j=1, verdict="verified", angle_deg=10.0, error_m=0.1, ok=True, grave=False, **more):
    answered = error_m is not None
    return PairRow(
        i=i,
        j=j,
        verdict=verdict,
        align_ms=50.0,
        T_i_j=pose(angle_deg, (1.0, 2.0, 3.0)) if answered else None,
        covariance=np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) if answered else None,
        T_i_j_true=pose(angle_deg),
        angle_deg=angle_deg,
        position_error_m=error_m,
        rotation_error_deg=0.1 if answered else None,
        ok=ok,
        grave=grave,
        start="features",
        inliers=40,
        reasons="because",
        **more,
    )


def posed_views(folder):
    write_posed_views(folder / "set", count=4)
    return open_recording(folder / "set", "sparse_noisy")


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_covariance_columns_are_the_upper_triangle_row_by_row():
    assert len(COVARIANCE_COLUMNS) == 21
    assert COVARIANCE_COLUMNS[:7] == ("c00", "c01", "c02", "c03", "c04", "c05", "c11")
    assert COVARIANCE_COLUMNS[-3:] == ("c44", "c45", "c55")
    covariance = np.arange(36.0).reshape(6, 6)
    covariance = covariance + covariance.T
    cells = pose_cells(np.eye(4), covariance)
    for name in COVARIANCE_COLUMNS:
        assert cells[name] == covariance[int(name[1]), int(name[2])]


def test_poses_csv_has_exactly_the_agreed_columns(tmp_path):
    write_tables(tmp_path, [row(), row(0, 2, "rejected", error_m=None, ok=False)])
    header = (tmp_path / "poses.csv").read_text().splitlines()[0].split(",")
    assert header[:4] == ["i", "j", "verdict", "align_ms"]
    assert header[4:11] == ["qw", "qx", "qy", "qz", "tx", "ty", "tz"]
    assert header[11:] == [*COVARIANCE_COLUMNS, "p_grave"]
    answered, unanswered = read(tmp_path / "poses.csv")
    assert (answered["i"], answered["j"], answered["verdict"]) == ("0", "1", "verified")
    assert [float(answered[k]) for k in ("tx", "ty", "tz")] == [1.0, 2.0, 3.0]
    assert float(answered["qw"]) == pytest.approx(np.cos(np.radians(5.0)))
    assert float(answered["qy"]) == pytest.approx(np.sin(np.radians(5.0)))
    assert all(unanswered[k] == "" for k in ("qw", "tx", "c00", "c55"))


def test_pairs_csv_adds_the_truth_and_leaves_blank_what_does_not_apply(tmp_path):
    write_tables(tmp_path, [row(shared=12)])
    (only,) = read(tmp_path / "pairs.csv")
    assert only["shared"] == "12"
    assert only["overlap"] == ""
    assert float(only["angle_deg"]) == 10.0
    assert float(only["position_error_m"]) == 0.1
    assert float(only["rotation_error_deg"]) == 0.1


def test_summary_counts_shares_of_all_pairs_in_question():
    rows = [
        row(),
        row(verdict="plausible", angle_deg=30.0),
        row(angle_deg=50.0, error_m=2.0, ok=False, grave=True),
        row(verdict="rejected", angle_deg=59.0, error_m=None, ok=False),
        row(verdict="rejected", angle_deg=80.0, error_m=None, ok=False),
    ]
    summary = summarize(rows, 10.0, [4.0, 6.0], rgbd=False)
    assert summary["ok_below_60"] == 0.5
    assert summary["verified_ok_below_60"] == 0.5
    assert summary["grave_verified"] == 1
    assert summary["view_ms"] == 5.0
    assert summary["align_ms_median"] == 50.0
    assert summary["verdicts"] == {"verified": 2, "plausible": 1, "rejected": 2}
    assert [b["pairs"] for b in summary["by_angle"]] == [1, 1, 2, 1, 0]
    assert summary["by_overlap"] is None


def test_recall_by_overlap_where_overlap_is_known():
    rows = [row(overlap=0.05, ok=False), row(overlap=0.1), row(overlap=1.0)]
    bins = summarize(rows, 2.0, [1.0], rgbd=True)["by_overlap"]
    assert [(b["pairs"], b["ok"]) for b in bins] == [
        (1, 0.0),
        (1, 1.0),
        (0, None),
        (0, None),
        (1, 1.0),
    ]


def test_the_plot_can_be_drawn_for_no_answer_at_all(tmp_path):
    plot_precision_recall(tmp_path / "none.png", [row(error_m=None, ok=False)])
    plot_precision_recall(tmp_path / "some.png", [row(), row(verdict="plausible", ok=False)])
    assert (tmp_path / "none.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "some.png").read_bytes().startswith(b"\x89PNG")


def test_summary_json_has_null_for_what_is_not_finite(tmp_path):
    write_summary(tmp_path, {"a": float("nan"), "b": [np.float64(1.5), None], "c": np.int64(3)})
    assert json.loads((tmp_path / "summary.json").read_text()) == {
        "a": None,
        "b": [1.5, None],
        "c": 3,
    }


def test_an_output_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputFolderError, match="--out"):
        output_folder(tmp_path / "file")


def test_success_by_overlap_counts_answers_that_are_not_grave():
    rows = [
        row(0, 1, overlap=0.15, ok=False),
        row(0, 2, overlap=0.15, ok=False, grave=True),
        row(1, 2, overlap=0.9, error_m=None, ok=False),
        row(1, 3, overlap=1.0),
    ]
    bins = summarize(rows, 2.0, [1.0], rgbd=True)["success_overlap"]
    assert [(b["from"], b["pairs"], b["share"]) for b in bins] == [
        (0.1, 2, 0.5), (0.2, 0, None), (0.3, 0, None), (0.4, 0, None), (0.5, 2, 0.5),
    ]  # fmt: skip
    assert summarize(rows, 2.0, [1.0], rgbd=False)["success_overlap"] is None


def test_closest_calls_begin_with_the_worst():
    rows = [
        row(0, 1, error_m=0.1),
        row(0, 2, error_m=0.4),
        row(0, 3, "plausible", error_m=9.0, ok=False, grave=True),
    ]
    calls = summarize(rows, 10.0, [1.0], rgbd=False)["closest_calls"]
    assert [call["j"] for call in calls["verified_largest_error"]] == [2, 1]
    assert calls["verified_largest_error"][0]["share_of_grave"] == pytest.approx(0.8)
    assert [call["j"] for call in calls["grave_most_support"]] == [3]


def test_unsolved_pairs_are_false_verdicts_first_and_spread_over_views():
    rows = [row(0, j, "rejected", ok=False, error_m=None, shared=1000 - j) for j in range(1, 20)]
    rows += [
        row(20, 21, grave=True, ok=False, shared=40),
        row(22, 23, "rejected", ok=False, angle_deg=80.0, shared=900),  # wide: allowed to fail
        row(24, 25, "rejected", ok=False, shared=29),  # hardly anything in common
        row(26, 27, shared=900),
    ]
    shown = [(one.i, one.j) for one in unsolved(rows, rgbd=False)]
    assert shown[0] == (20, 21)
    assert shown[1:] == [(0, 1), (0, 2), (0, 3), (0, 4)]


@pytest.mark.parametrize("rgbd", [False, True])
def test_the_report_shows_unsolved_pairs_and_needs_nothing_beside_it(tmp_path, rgbd):
    recording = posed_views(tmp_path)
    if rgbd:
        write_rgbd(tmp_path / "rgbd", count=4)
        recording = open_recording(tmp_path / "rgbd")
    rows = [
        row(shared=200, overlap=0.9),
        row(0, 2, "rejected", error_m=None, ok=False, shared=200, overlap=0.8),
    ]
    rows[1].reasons = "<b>no start</b>"
    write_results(tmp_path, recording, rows, 10.0, [5.0])
    text = (tmp_path / "report.html").read_text()
    sources = re.findall(r'(?:src|href)\s*=\s*"?([^">]*)', text)
    assert sources
    assert all(source.startswith("data:image/") for source in sources)
    assert "http" not in re.sub(r'base64,[^"]*', "", text)
    assert text.count("<figure>") == 1
    assert "&lt;b&gt;no start&lt;/b&gt;" in text
    assert "<td>100.0 %</td>" in text
    raw = [one for one in re.findall(r"<t[dh]>([^<]*)", text) if "_" in one]
    assert not raw, "names of summary.json"
    assert text.count("<table>") == text.count("<div class=wide><table>"), "none is too wide"
    for name in ("recall_over_angle", "precision_recall", "position_error", "nees"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_all_plots_can_be_drawn_for_no_pair_at_all(tmp_path):
    assert all(path.exists() for path in plot_all(tmp_path, [], 10.0).values())
