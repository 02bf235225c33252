"""The base of all messages."""

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict


class Message(BaseModel, frozen=True):
    """A frozen message without unknown fields; `schema` names it and its version on the wire."""

    schema_name: ClassVar[str]
    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    def __init_subclass__(cls, schema: str, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.schema_name = schema
