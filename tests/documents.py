"""Reads what can be checked out of a Markdown document: links, commands, options, Python."""

import re
import shlex
from collections.abc import Container, Iterator
from dataclasses import dataclass
from typing import Any

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)
_INDENTED = re.compile(r"(?:^(?: {4}|\t).*\n?)+", re.M)
_SPAN = re.compile(r"`([^`]+)`")
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


class WrongCommandError(Exception):
    """A command line in a document that its program would refuse."""


@dataclass(frozen=True)
class Command:
    """A command line of ours, split as a shell does it."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        return " ".join(self.words)


def spans_in(text: str) -> list[str]:
    """The code spans of the paragraphs, each on one line."""
    return [" ".join(span.split()) for span in _SPAN.findall(_without_blocks(text))]


def python_in(text: str) -> list[str]:
    """The blocks of Python."""
    return [block for language, block in _FENCE.findall(text) if language == "python"]


def links_in(text: str) -> list[tuple[str, str]]:
    """Relative links and pictures: the file, empty for the document itself, and the anchor."""
    targets = _LINK.findall(_SPAN.sub("", _without_blocks(text)))
    ours = [target.partition("#") for target in targets if "://" not in target]
    return [(file, anchor) for file, _, anchor in ours]


def headings_of(text: str) -> set[str]:
    """The anchors of a document's headings."""
    plain = re.findall(r"^#+ (.*)$", _FENCE.sub("", text), re.M)
    return {re.sub(r"[^\w\s-]", "", one).strip().lower().replace(" ", "-") for one in plain}


def options_in(text: str) -> list[str]:
    """Options that stand alone in a code span, e.g. of `--size 2560x720 --fps 30`."""
    alone = [span for span in spans_in(text) if span.startswith("--")]
    return [flag for span in alone for flag in re.findall(r"(?<!\S)--[a-z][a-z-]*", span)]


def commands_in(text: str, programs: Container[str]) -> list[Command]:
    """The command lines of these programs, in code spans and blocks."""
    blocks = [block for _, block in _FENCE.findall(text)]
    blocks += _INDENTED.findall(_FENCE.sub("", text))
    lines = [*spans_in(text), *(line for block in blocks for line in block.splitlines())]
    return [command for line in lines for command in _split(line, programs)]


def checked(command: Command, program: Any) -> None:
    """Follows a command line through a program's commands and options.

    Args:
        command: what a document says.
        program: the program's click command; typer brings a click of its own.

    Raises:
        WrongCommandError: there is no such command or option, or a value or an argument is
            missing or too many.
    """
    here, words, arguments = program, list(command.words[1:]), 0
    while words:
        word = words.pop(0)
        below = getattr(here, "commands", None)
        if word.startswith("-") and len(word) > 1:
            _take_option(here, word, words, command)
        elif below is not None:
            if word not in below:
                raise WrongCommandError(f"{command}: there is no command '{word}'")
            here = below[word]
        elif word != "...":
            arguments += 1
            if arguments > _most_arguments(here):
                raise WrongCommandError(f"{command}: '{word}' is one argument too many")


def flags_of(command: Any) -> set[str]:
    """All options of a command and of those below it."""
    below = getattr(command, "commands", {}).values()
    own = {flag for one in command.params for flag in (*one.opts, *one.secondary_opts)}
    return own.union(*map(flags_of, below))


def _take_option(here: Any, word: str, words: list[str], command: Command) -> None:
    """Takes an option, and its values from the words behind it."""
    flag, equals, _ = word.partition("=")
    options = [one for one in here.params if one.param_type_name == "option"]
    option = next((one for one in options if flag in (*one.opts, *one.secondary_opts)), None)
    if option is None:
        raise WrongCommandError(f"{command}: '{flag}' is no option there")
    if option.is_flag or equals:
        return
    if len(words) < option.nargs:
        raise WrongCommandError(f"{command}: '{flag}' needs a value")
    del words[: option.nargs]


def _most_arguments(command: Any) -> float:
    counts = [one.nargs for one in command.params if one.param_type_name == "argument"]
    return float("inf") if -1 in counts else sum(counts)


def _split(line: str, programs: Container[str]) -> Iterator[Command]:
    """A line without its comment, prompt and redirections, if it is a command of ours."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError:
        return  # prose with an apostrophe
    end = next((n for n, word in enumerate(words) if word in (">", "<", "|", "&&")), len(words))
    if words and words[0] in programs:
        yield Command(tuple(words[:end]))


def _without_blocks(text: str) -> str:
    return _INDENTED.sub("\n", _FENCE.sub("\n", text))
