"""Bars 6 and 12: each state in both themes, on a desk and on a tablet: how it looks, and whether
the page says what the text client says.
"""

from collections import defaultdict
from typing import Any

from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row
from fleetpose.evaluation.system.web.states.audit import faults, said
from fleetpose.evaluation.system.web.states.tour import scenes

SIZES = {"desk": (1600, 1000), "tablet": (1024, 768)}
THEMES = ("dark", "light")
STATES = 10
_DRAWN = """() => document.fonts.ready.then(() => new Promise((done) => {
    let frames = 3;
    const next = () => (frames-- ? requestAnimationFrame(next) : done());
    next();
}))"""
_THEME = """(theme) => {
    if (document.documentElement.dataset.theme !== theme) document.getElementById('theme').click();
}"""


def how_it_looks(bench: Bench) -> list[Row]:
    """Contrast, targets, cut texts, scroll bars, and what the page asks for and complains of."""
    found: dict[str, list[str]] = defaultdict(list)
    shown = 0
    pages: dict[int, Any] = {}
    for name, page in scenes(bench):
        bench.said(name)
        shown += 1
        pages[id(page)] = page
        for theme, size in _variants(page):
            for kind, faulty in faults(page, size == "tablet").items():
                found[kind] += [f"{name}, {theme}, {size}: {one}" for one in faulty]
    wrongs = [bench.browser.wrongs(page) for page in pages.values()]
    found["foreign"] = [url for one in wrongs for url in one.foreign]
    found["console"] = [text for one in wrongs for text in one.console]
    (bench.out / "faults.txt").write_text(
        "".join(f"{kind}: {one}\n" for kind, many in found.items() for one in many)
    )
    what = {
        "contrast": "texts below 4.5:1",
        "targets": "tablet's targets below 44 px",
        "cut": "texts that are cut",
        "scroll bars": "scroll bars of the page",
        "foreign": "requests to other origins",
        "console": "errors on the console",
    }
    rows = [Row(6, name, float(len(found[k])), "= 0", not found[k]) for k, name in what.items()]
    return [
        Row(6, "states, each in 2 themes and 2 sizes", str(shown), f"= {STATES}", shown == STATES),
        *rows,
    ]


def as_it_is_told(bench: Bench) -> list[Row]:
    """A screenshot of each state, and its sentences beside those of the text client."""
    rows = []
    for name, page in scenes(bench):
        bench.said(name)
        for theme, size in _variants(page):
            bench.screenshot(page, f"{name}_{theme}_{size}".replace(" ", "_"))
        words = said(page)
        if not words.alike:
            (bench.out / f"{name}.txt").write_text(f"{words}\n")
        rows.append(
            Row(
                12,
                f"{name}: sentences of page and terminal",
                "same" if words.alike else "differ",
                "same",
                words.alike,
            )
        )
    return rows


def _variants(page: Any) -> Any:
    """Brings a page into each theme and size, and at last back."""
    for size in ("tablet", "desk"):
        width, height = SIZES[size]
        page.set_viewport_size({"width": width, "height": height})
        for theme in THEMES[::-1]:
            page.evaluate(_THEME, theme)
            hands.wait_knows(page, f"state.theme === '{theme}'")
            page.evaluate(_DRAWN)
            page.wait_for_timeout(200)
            yield theme, size
