"""The page of settings is what the settings classes say."""

import runpy
from pathlib import Path

from fleetpose.pose_server.settings import ServerSettings

ROOT = Path(__file__).parent.parent
SCRIPT = ROOT / "scripts/settings_page.py"


def test_the_page_of_settings_is_the_one_that_its_script_prints():
    printed = runpy.run_path(str(SCRIPT))["page"]()
    assert (ROOT / "docs/settings.md").read_text() == printed, (
        "python scripts/settings_page.py > docs/settings.md"
    )


def test_a_setting_that_changes_changes_the_page(monkeypatch):
    page = runpy.run_path(str(SCRIPT))["page"]
    before = page()
    monkeypatch.setattr(ServerSettings.model_fields["fresh_s"], "default", 7.0)
    assert page() != before
