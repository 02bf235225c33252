"""Sessions that look and change nothing: an observer's, and a recording that is played."""

from collections.abc import Callable
from typing import ClassVar, NoReturn

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.session import OperatorSession


class Onlooker(OperatorSession):
    """A session whose commands are refused; nothing of it goes out."""

    acts: ClassVar[bool] = False
    refusal: ClassVar[str] = (
        "you may only look: your configuration is an observer's; clicks need an operator's"
    )

    def undo(self) -> NoReturn:
        raise OperatorError(self.refusal)

    def redo(self) -> NoReturn:
        raise OperatorError(self.refusal)

    def pick(self, *_: object, **__: object) -> NoReturn:
        raise OperatorError(self.refusal)

    def _do(self, deed: Callable[[], object]) -> NoReturn:
        raise OperatorError(self.refusal)
