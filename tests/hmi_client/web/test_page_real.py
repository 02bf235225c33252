"""The page in a real browser, the real bridge, a router and a server that is small."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")
CHROMIUM = shutil.which("chromium")
if CHROMIUM is None:
    pytest.skip("there is no chromium: apt-get install chromium", allow_module_level=True)

from real_bridge import real_bridge  # noqa: E402 (needs what may be missing)

LEFT, RIGHT = "[data-panel=left]", "[data-panel=right]"


def _until(page, done, timeout_s: float = 8.0) -> None:
    end = time.monotonic() + timeout_s
    while not done():
        said = page.inner_text("#bar")
        assert time.monotonic() < end, f"not within {timeout_s} s; the bar says {said!r}"
        page.wait_for_timeout(20)


def test_two_clicks_in_the_browser_become_a_correspondence_of_the_server(serve, router, tmp_path):
    server, wrong = serve(), []
    with real_bridge(router, tmp_path) as bridge, sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1600, "height": 1000})
        page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: wrong.append(str(e)))
        page.goto(f"{bridge.url}#token={bridge.token}")
        _until(page, lambda: page.locator("[data-at='0,1']").count() > 0)
        page.click("[data-at='0,1']")
        for side in (LEFT, RIGHT):
            _until(page, lambda side=side: page.inner_text(f"{side} h2").find("view") > 0)
        page.click(f"{LEFT} canvas.photo", position={"x": 150, "y": 120})
        page.keyboard.press("Space")
        _until(page, lambda: page.inner_text(f"{RIGHT} .tag") == "click the same point here")
        page.click(f"{RIGHT} canvas.loupe", position={"x": 60, "y": 60})
        _until(page, lambda: page.inner_text("footer .kept") == "✓ all 1 click confirmed")
        _until(page, lambda: page.locator("#pair .say.confirmed").count() == 1)
        if shots := os.environ.get("FLEETPOSE_SHOTS"):
            page.screenshot(path=str(Path(shots) / "real.png"))
        browser.close()
    (update,) = server.updates
    assert (update.i, update.j, update.operator) == ("r1", "r2", "kim")
    assert wrong == []


def _certificate(folder: Path) -> dict[str, Any]:
    """One that nobody has signed, for this machine."""
    paths = {"certificate": folder / "web.pem", "key": folder / "web.key"}
    asked = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1"]
    files = [
        "-subj",
        "/CN=127.0.0.1",
        "-out",
        str(paths["certificate"]),
        "-keyout",
        str(paths["key"]),
    ]
    subprocess.run([*asked, "-subj", "/CN=127.0.0.1", *files], check=True, capture_output=True)
    return paths


def test_by_tls_a_token_names_its_operator_and_a_wrong_one_is_told(router, tmp_path):
    tokens = {"token-of-kim-1234": "kim", "token-of-ana-1234": "ana"}
    reach = _certificate(tmp_path)
    with (
        real_bridge(router, tmp_path, tokens, **reach) as bridge,
        sync_api.sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        assert bridge.url.startswith("https://")
        for token, name in tokens.items():
            page = browser.new_context(ignore_https_errors=True).new_page()
            page.goto(f"{bridge.url}#token={token}")
            _until(page, lambda page=page, name=name: f"you: {name}" in page.inner_text("#who"))
        page = browser.new_context(ignore_https_errors=True).new_page()
        page.goto(f"{bridge.url}#token=guessed")
        _until(page, lambda: "The token is not right" in page.inner_text("#bar"))
        browser.close()
