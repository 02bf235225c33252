"""The base of all messages."""

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict


class Message(BaseModel, frozen=True):
    """A frozen message without unknown fields; `schema` names it and its version on the wire.

    A new version only adds fields, each with a default, and names the version `before` it, which
    is then still read.
    """

    schema_name: ClassVar[str]
    schema_before: ClassVar[str | None]
    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    def __init_subclass__(cls, schema: str, before: str | None = None, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.schema_name, cls.schema_before = schema, before
