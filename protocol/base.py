"""The base of all messages."""

from typing import ClassVar

from pydantic import BaseModel, ConfigDict


class Message(BaseModel, frozen=True):
    """A frozen message; unknown fields are refused. `schema_name` names it and its version on the
    wire.
    """

    schema_name: ClassVar[str]
    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
