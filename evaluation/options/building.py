"""Commands from dataclasses: each option is told once, as a field."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import wraps
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import typer

F = TypeVar("F", bound=Callable[..., Any])


def _with_commas(values: Any) -> str:
    return ",".join(map(str, values))


@dataclass(frozen=True)
class Text:
    """How a field's value is written as one text on the command line.

    Attributes:
        read: makes the value of the option's name and the text.
        shown: the text of the default value.
    """

    read: Callable[[str, str], Any]
    shown: Callable[[Any], str] = _with_commas


def told(help: str, default: Any = None, *flags: str, text: Text | None = None, **more: Any) -> Any:
    """A field of a dataclass that is an option as well.

    Args:
        help: what it means.
        default: `...` if it must be given.
        flags: where the option is not called as the field.
        text: for values that are written as one text.
        more: what `typer.Option` takes.
    """
    option = typer.Option(*flags, help=help, **more)
    return field(
        default=MISSING if default is ... else default, metadata={"option": option, "text": text}
    )


def numbers(option: str, text: str, count: int | None = None) -> tuple[int, ...]:
    """Whole numbers with commas between them; none of an empty text.

    Raises:
        FleetPoseError: it is something else, or another count.
    """
    from fleetpose.protocol.errors import FleetPoseError

    try:
        found = tuple(int(part) for part in text.split(",")) if text else ()
    except ValueError:
        found = ()
    if (text and not found) or (count is not None and len(found) != count):
        raise FleetPoseError(f"{option} {text!r}: write numbers like 0,3 or 40,90")
    return found


def of(settings: type) -> Callable[[F], F]:
    """Gives a command an option for every field of a dataclass; it gets an object of that class as
    its first argument. Fields that are tuples are options that may be repeated.
    """
    hints = get_type_hints(settings)
    known = [_Known(one, hints[one.name]) for one in fields(settings)]

    def decorate(command: F) -> F:
        own = list(inspect.signature(command).parameters.values())[1:]

        @wraps(command)
        def with_options(**given: Any) -> Any:
            values = {one.name: one.value(given.pop(one.name)) for one in known}
            return command(settings(**values), **given)

        parameters = [one.parameter for one in known]
        parameters += [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own]
        with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        with_options.__annotations__ = {one.name: one.annotation for one in parameters}
        return with_options  # type: ignore[return-value]

    return decorate


class _Known:
    """A field as an option."""

    def __init__(self, of: Field[Any], kind: Any) -> None:
        option = of.metadata["option"]
        self.name, self._text = of.name, of.metadata["text"]
        self._flag = (option.param_decls or [f"--{of.name.replace('_', '-')}"])[0]
        self._listed = self._text is None and get_origin(kind) is tuple
        default = inspect.Parameter.empty if of.default is MISSING else of.default
        if self._text is not None:
            kind, default = str, self._text.shown(default)
        elif self._listed:
            kind, default = list[get_args(kind)[0]] | None, None  # pyright: ignore[reportInvalidTypeArguments]
        self.parameter = inspect.Parameter(
            of.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[kind, option],
        )

    def value(self, given: Any) -> Any:
        if self._text is not None:
            return self._text.read(self._flag, given)
        return tuple(given or ()) if self._listed else given
