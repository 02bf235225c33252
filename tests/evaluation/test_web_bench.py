"""The bench of the operator's page: it measures in a browser, and a missed limit is told."""

import json
import shutil

import pytest
from typer.testing import CliRunner

from fleetpose.evaluation.cli.live import app
from fleetpose.evaluation.options.web import WebOptions
from fleetpose.evaluation.system.web import browser, command
from fleetpose.evaluation.system.web.bars import link
from fleetpose.evaluation.system.web.bars.many import Sample, grown
from fleetpose.evaluation.system.web.rows import all_met, at_least, at_most, unmeasured


def test_a_row_is_met_only_by_a_figure_within_its_limit():
    assert at_most(1, "x", 50.0, 50.0).met is True
    assert at_most(1, "x", 50.1, 50.0).met is False
    assert at_most(1, "x", None, 50.0).met is False
    assert at_least(1, "x", 1.0, 2.0).met is False
    assert not all_met([at_most(1, "x", 1.0, 2.0), unmeasured(2, "y", "no such thing")])
    assert not all_met([])


def test_an_image_is_as_old_as_when_the_next_one_replaced_it():
    assert link.ages_s([(3, 900.0), (6, 1500.0)], [(2, 100.0), (4, 300.0), (6, 500.0)]) == [1.4]


def test_memory_that_grows_misses_its_bar():
    flat = [Sample(k, 200_000_000, 90_000_000, 5_000_000) for k in range(40)]
    growing = [
        Sample(k, 200_000_000 + 10**6 * k, 90_000_000 + 10**6 * k, 5 * 10**6 + 10**5 * k)
        for k in range(40)
    ]
    assert [row.met for row in grown(flat, 40)] == [True] * 3
    assert [row.met for row in grown(growing, 40)] == [False] * 3


def test_without_a_browser_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(browser.shutil, "which", lambda _: None)
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    done = CliRunner().invoke(app, ["web", "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert done.output.strip() == browser.MISSING_CHROMIUM


def test_a_limit_that_a_small_fleet_misses_is_told_as_missed(tmp_path, monkeypatch, capsys):
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if shutil.which("chromium") is None:
        pytest.skip("there is no chromium: apt-get install chromium")
    monkeypatch.setattr(link, "STATE_KB_PER_S", 0.001)
    monkeypatch.setitem(command.BARS, 4, lambda bench: [link.state(bench)])
    assert command.run_web(WebOptions(bars="4", robots=3, quick=True), tmp_path) == 1
    (row,) = json.loads((tmp_path / "summary.json").read_text())["rows"]
    assert (row["met"], row["value"] > 0.1) == (False, True)
    assert "NOT MET" in capsys.readouterr().out
    assert "NOT MET" in (tmp_path / "report.md").read_text()
