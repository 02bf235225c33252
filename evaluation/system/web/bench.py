"""What a bar is given to measure with."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fleetpose.evaluation.options.web import WebOptions
from fleetpose.evaluation.system.web.browser import Browser
from fleetpose.evaluation.system.web.site import WebSite


@dataclass(frozen=True)
class Bench:
    """Made anew for each bar, so that none sees what another left.

    Attributes:
        site: runs; a bar that needs another one makes it by `another_site` after this one.
        browser: runs, without a page.
        out: folder of this bar's screenshots and other files.
        options: what the command was asked for.
        said: shows what is being done beside the progress bar.
    """

    site: WebSite
    browser: Browser
    out: Path
    options: WebOptions
    said: Callable[[str], None] = lambda _: None

    def many(self, usual: int, quick: int) -> int:
        """How often something is done; fewer times with `--quick`."""
        return quick if self.options.quick else usual

    def screenshot(self, page: object, name: str) -> Path:
        """A picture of a page as `OUT/screenshots/<bar>_<name>.png`."""
        path = self.out.parent / "screenshots" / f"{self.out.name}_{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=str(path))  # pyright: ignore[reportAttributeAccessIssue]
        return path
