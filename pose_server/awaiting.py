"""Updates that click in a view which the server never got and its robot may still have: they wait
for the answer, and are judged by it.
"""

from collections.abc import Callable

from protocol.messages import OperatorUpdate, ViewName

_MOST_WAITING = 1000  # beyond, an operator's client repeats what it sent


class Awaiting:
    """Updates by the views they wait for.

    Args:
        ask: asks for a view; whether an answer will come.
    """

    def __init__(self, ask: Callable[[ViewName], bool]) -> None:
        self._ask = ask
        self._waiting: dict[tuple[str, str, int], tuple[OperatorUpdate, set[ViewName]]] = {}
        self._refused: dict[ViewName, str] = {}

    def parks(self, update: OperatorUpdate, missing: set[ViewName]) -> bool:
        """Whether the update waits now; not for views that were refused before."""
        asked = {view for view in missing - set(self._refused) if self._ask(view)}
        if not asked:
            return False
        if len(self._waiting) < _MOST_WAITING:
            self._waiting[update.operator, update.session, update.n] = (update, asked)
        return True

    def answered(self, view: ViewName, refused: str = "") -> list[OperatorUpdate]:
        """Notes what became of a view; the updates that wait for nothing more, in order."""
        if refused:
            self._refused[view] = refused
            self._refused = dict(list(self._refused.items())[-_MOST_WAITING:])
        for _, views in self._waiting.values():
            views.discard(view)
        ready = [key for key, (_, views) in self._waiting.items() if not views]
        return [self._waiting.pop(key)[0] for key in sorted(ready)]
