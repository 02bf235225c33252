"""Updates that must wait before they are judged: for a view that the server never got and its robot
may still have, or, soon after a start, for the robot itself.
"""

from collections.abc import Callable

from fleetpose.protocol.messages import OperatorUpdate, ViewName

_MOST_WAITING = 1000  # beyond, an operator's client repeats what it sent
_YOUNG_S = 10.0  # after a start everybody comes back in any order, operators before robots too


class PendingUpdates:
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


class StartupGrace:
    """Updates about robots that a server has not heard of yet, while it is young.

    Args:
        began_s: when the server began, monotonic seconds.
        is_here: whether a view is kept, or its robot has been heard of.
    """

    def __init__(self, began_s: float, is_here: Callable[[ViewName], bool]) -> None:
        self._old_s = began_s + _YOUNG_S
        self._is_here = is_here
        self._held: dict[tuple[str, str, int], OperatorUpdate] = {}

    def holds(self, update: OperatorUpdate, now_s: float) -> bool:
        """Whether the update waits now; one that finds no room is repeated by its client."""
        if now_s >= self._old_s or self._are_here(update):
            return False
        if len(self._held) < _MOST_WAITING:
            self._held[update.operator, update.session, update.n] = update
        return True

    def ready(self, now_s: float) -> list[OperatorUpdate]:
        """Those that wait no longer, in order."""
        old = now_s >= self._old_s
        keys = [key for key, update in self._held.items() if old or self._are_here(update)]
        return [self._held.pop(key) for key in sorted(keys)]

    def _are_here(self, update: OperatorUpdate) -> bool:
        views = (update.view_i, update.view_j)
        return all(self._is_here(view) for view in views if view is not None)
