"""Deserialises messages by the definitions that their bag brings, else by those of ROS itself."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Literal, NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from fleetpose.protocol.errors import CodecError

Coding = Literal["cdr", "ros1", "unknown"]
Read = Callable[[bytes, str], Any]

_IDL_PART = "=" * 80 + "\n"
_DISTRIBUTIONS = (Stores.LATEST, Stores.ROS2_FOXY, Stores.ROS2_DASHING)
"""Whose definitions are tried where a bag has none, or others than its messages were written by:
types have changed, e.g. `rcl_interfaces/msg/Log` between Dashing and Foxy."""


class Kind(NamedTuple):
    """A type as a bag has it: its name, its definition, and how its messages are coded."""

    name: str
    definition: MessageDefinition
    coding: Coding


class Types:
    """Reads messages; a type is compiled when its first message is read.

    A type that cannot be read costs its own messages, and no others.
    """

    def __init__(self) -> None:
        self._shared = get_typestore(Stores.EMPTY)
        self._readers: dict[Kind, Read] = {}

    def read(self, kind: Kind, raw: bytes) -> Any:
        """The message, with the fields that its type names.

        Raises:
            CodecError: its type is not known, or it is damaged.
        """
        if kind not in self._readers:
            self._readers[kind] = self._reader(kind, raw)
        return _read(self._readers[kind], raw, kind.name)

    def _reader(self, kind: Kind, raw: bytes) -> Read:
        """What reads a type, tried on a message of it.

        Raises:
            CodecError: nothing does.
        """
        if kind.coding == "unknown":
            raise CodecError(f"{kind.name}: neither CDR nor of ROS 1")
        why: CodecError | None = None
        for store in self._stores(kind):
            reader = store.deserialize_ros1 if kind.coding == "ros1" else store.deserialize_cdr
            if kind.name not in store.fielddefs:
                continue
            try:
                _read(reader, raw, kind.name)
            except CodecError as error:
                why = why or error
            else:
                return reader
        raise why or CodecError(f"{kind.name}: the bag has no definition of it, and ROS has none")

    def _stores(self, kind: Kind) -> Iterator[Typestore]:
        if kind.definition.format != MessageDefinitionFormat.NONE:
            yield self._own_store(kind)
        names = (Stores.ROS1_NOETIC,) if kind.coding == "ros1" else _DISTRIBUTIONS
        yield from map(_distribution, names)

    def _own_store(self, kind: Kind) -> Typestore:
        """One with the bag's own definition.

        Raises:
            CodecError: that cannot be read.
        """
        try:
            defined = _defined(kind)
        except Exception as error:  # a parser on a stranger's text raises whatever it likes
            raise CodecError(f"{kind.name}: its definition cannot be read ({error})") from error
        try:
            self._shared.register(defined)
        except TypesysError:  # parts of it are defined otherwise in another topic of the bag
            own = get_typestore(Stores.EMPTY)
            own.register(defined)
            return own
        return self._shared


@cache
def _distribution(name: Stores) -> Typestore:
    return get_typestore(name)


@contextmanager
def as_defined() -> Iterator[None]:
    """Messages are used here by the fields that ROS gives their types.

    Raises:
        CodecError: one lacks a field, as the definition that its bag brings is another.
    """
    try:
        yield
    except AttributeError as error:
        kind = getattr(error.obj, "__msgtype__", None)
        if kind is None:
            raise
        raise CodecError(f"a message of {kind} has no field '{error.name}'") from error


def _defined(kind: Kind) -> dict[str, Any]:
    text = kind.definition.data
    if kind.definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text, kind.name)
    if not text.startswith(f"{_IDL_PART}IDL: "):
        return get_types_from_idl(text)
    types: dict[str, Any] = {}
    for part in text.split(_IDL_PART)[1:]:
        types.update(get_types_from_idl(part.partition("\n")[2]))
    return types


def _read(reader: Read, raw: bytes, name: str) -> Any:
    try:
        return reader(raw, name)
    except Exception as error:  # generated code on foreign bytes raises whatever it likes
        told = str(error) or type(error).__name__
        raise CodecError(f"a message of {name} cannot be read ({told})") from error
