"""The operator's page in a browser, beside a bridge that only says what a test wants."""

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from pages import DESK, SETTLED, until


@pytest.fixture(scope="module")
def bridge() -> Iterator[tuple]:
    pytest.importorskip(
        "starlette", reason="starlette is not installed: pip install 'fleetpose[web]'"
    )
    pytest.importorskip("uvicorn", reason="pip install 'fleetpose[web]'")
    from fake_bridge import FakeBridge

    fake = FakeBridge()
    with fake.serving() as url:
        yield fake, url


@pytest.fixture(scope="module")
def browser() -> Iterator:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if (chromium := shutil.which("chromium")) is None:
        pytest.skip("there is no chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        yield launched
        launched.close()


@pytest.fixture
def opened(bridge, browser):
    """Opens the page in a state; no console error and no foreign request may come of it."""
    fake, url = bridge
    contexts, errors, foreign = [], [], []

    def open_page(scene, size=DESK, touch=False, ratio=1.0, theme="dark", settled=True):
        fake.show(scene, {"theme": theme})
        width, height = size
        context = browser.new_context(
            viewport={"width": width, "height": height}, has_touch=touch, device_scale_factor=ratio
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: errors.append(str(e)))
        page.on("request", lambda r: foreign.append(r.url) if not r.url.startswith(url) else None)
        page.goto(url + "#token=let-me-in")
        if settled:
            sides = sum(isinstance(f, bytes) and f[0] == 1 for f in scene)
            until(page, lambda: sum(m["do"] == "ack" for m in fake.heard) >= sides)
            until(page, lambda: page.inner_text("#summary") != "")
            page.evaluate(SETTLED)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert errors == []
    assert [one for one in foreign if not one.startswith("blob:")] == []
