"""What is wrong with a page as it is drawn, and whether it says what the text client says."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleetpose.evaluation.system.web import hands
from fleetpose.hmi_client.desk.advice import Action, Step
from fleetpose.hmi_client.tui.panels.status_panel import do_lines, fitting

CONTRAST, TARGET_PX = 4.5, 44
SCRIPT = Path(__file__).with_name("audit.js").read_text().strip()
_WIDE = 10_000  # columns: all facts
_FACTS = """() => [...document.querySelectorAll('#bar .facts > div:not(.legs-fact)')].map(
    (node) => [...node.children].map((part) => part.textContent))"""


def faults(page: Any, tablet: bool) -> dict[str, list[str]]:
    """Faults by their kind: contrast below 4.5:1, texts that are cut, scroll bars of the page, and
    on a tablet targets below 44 px.
    """
    limits = {"contrast": CONTRAST, "cut": 0, "scroll bars": 0}
    limits |= {"targets": TARGET_PX} if tablet else {}
    return {what: page.evaluate(f"() => ({SCRIPT})('{what}', {at})") for what, at in limits.items()}


@dataclass(frozen=True)
class Said:
    """The sentences of a step as the text client and the page show them.

    Attributes:
        title, facts: of the text client, all that it would show if it were wide enough.
        page_title, page_facts: of the page: the first three facts.
    """

    title: str
    facts: tuple[str, ...]
    page_title: str
    page_facts: tuple[str, ...]

    @property
    def alike(self) -> bool:
        """Whether they are the same, word for word; letters may be large or small."""
        shown = list(map(_words, self.page_facts))
        facts = list(map(_words, self.facts))
        if self.page_title != self.title:  # the overview has a title of its own
            return any(_words(self.title) == fact[-len(_words(self.title)) :] for fact in shown)
        return shown == facts[: len(shown)] and len(shown) >= min(len(facts), 3)


def said(page: Any) -> Said:
    """What a page shows of the step that its bridge has sent, beside what a terminal would show."""
    told = hands.knows(page, "step")
    actions = [Action(a["do"], a["label"], a["key"], a["args"]) for a in told["actions"]]
    step = Step(told["tone"], told["title"], tuple(told["facts"]), tuple(actions))
    shown = fitting(step.facts, _WIDE)
    return Said(
        do_lines(step, 0)[0],
        tuple(shown.split("  ·  ")) if shown else (),
        page.inner_text("#bar h1"),
        tuple(": ".join(parts) for parts in page.evaluate(_FACTS)),
    )


def _words(text: str) -> Sequence[str]:
    return re.findall(r"[^\s:]+", text.casefold())
