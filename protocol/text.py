"""Texts of messages and logs: the release, and what came from elsewhere, made fit for a line."""

import re
from functools import cache
from importlib.metadata import version


@cache
def release() -> str:
    """The version of the installed package, read once: its files take milliseconds."""
    return version("fleetpose")


def without_source(said: str) -> str:
    """What zenoh said, without where in its own source: paths of the machine that built it."""
    return re.sub(r" at /\S+:\d+\.?", "", said)


def one_line(text: str, at_most: int = 2000) -> str:
    """The text on one line, cut to a length; signs that a terminal would obey become spaces.

    Line breaks, escape sequences, signs that turn the direction of writing and lone surrogates are
    not printable, so that no text can forge a log entry or a screen.
    """
    text = text[:at_most]
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else " " for sign in text)
