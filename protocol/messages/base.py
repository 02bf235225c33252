"""The base of all messages."""

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict

MAX_MESSAGE_BYTES = 16 * 1024 * 1024
"""Of messages with clouds, images or the whole fleet."""
MAX_SMALL_BYTES = 1024 * 1024


class Message(BaseModel, frozen=True):
    """A frozen message without unknown fields; `schema` names it and its version on the wire.

    A new version only adds fields, each with a default, and names the version `before` it, which
    is then still read. What is longer than `at_most` bytes is not read.
    """

    schema_name: ClassVar[str]
    schema_before: ClassVar[str | None]
    at_most: ClassVar[int]
    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    def __init_subclass__(
        cls,
        schema: str,
        before: str | None = None,
        at_most: int = MAX_SMALL_BYTES,
        **kwargs: Any,
    ) -> None:
        super().__init_subclass__(**kwargs)
        cls.schema_name, cls.schema_before, cls.at_most = schema, before, at_most
