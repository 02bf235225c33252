"""How an operator's page looks, kept on disk: an address that changes must not lose it."""

import json
import logging
from pathlib import Path
from typing import Any

log = logging.getLogger(__name__)
MOST_BYTES = 16_384


class PageSettings:
    """A JSON file of one operator's pages. One that is damaged counts as empty.

    Args:
        path: the file; none keeps nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.values: dict[str, Any] = {}
        if path is not None and path.exists():
            try:
                told = json.loads(path.read_text(encoding="utf-8"))
                self.values = told if isinstance(told, dict) else {}
            except (OSError, ValueError) as error:
                log.warning("%s is not used: %s", path, error)

    def set(self, changed: dict[str, Any]) -> None:
        """Takes values over those that were, unless it becomes too much."""
        values = self.values | changed
        text = json.dumps(values)
        if len(text) > MOST_BYTES or values == self.values:
            return
        self.values = values
        if self._path is None:
            return
        beside = self._path.with_suffix(".new")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            beside.write_text(text, encoding="utf-8")
            beside.replace(self._path)
        except OSError as error:  # the page looks as it should, only not next time
            log.warning("%s cannot be written: %s", self._path, error)
