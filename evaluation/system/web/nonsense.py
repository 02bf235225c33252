"""Frames that no page of ours sends, drawn by chance."""

import json
import random
from collections.abc import Callable

_VALUES = (None, True, "x", "", -1, 2, 1e400, [], [1], [1, 2, 3], {}, {"a": [[]]}, "NaN", "\ud800")
_ARGUMENTS = ("side", "pixel", "view", "id", "a", "robot", "set", "paused", "images", "nobody")
_COMMANDS = ("pick", "cursor", "select", "ack", "want", "settings", "erase", "move", "seek")


def frames_of_nonsense(count: int, seed: int = 0) -> list[str | bytes]:
    """So many malformed frames: no JSON, no object, no command, wrong arguments, and bytes."""
    chance = random.Random(seed)
    return [chance.choice(_KINDS)(chance) for _ in range(count)]


def _noise(chance: random.Random) -> str:
    return "!" + "".join(chance.choices('{}[]":,\x00é☃xn0', k=chance.randrange(60)))


def _bytes(chance: random.Random) -> bytes:
    return chance.randbytes(chance.randrange(1, 60))


def _no_object(chance: random.Random) -> str:
    return json.dumps(chance.choice(_VALUES))


def _deep(chance: random.Random) -> str:
    return "[" * chance.randrange(1, 30_000)


def _no_command(chance: random.Random) -> str:
    return json.dumps({"do": chance.choice(("", "__init__", "_do_pick", "drop table", "x" * 5000))})


def _do_is_no_text(chance: random.Random) -> str:
    return json.dumps({"do": chance.choice((1, None, ["pick"], {"do": "pick"}))})


def _wrong_argument(chance: random.Random) -> str:
    wrong = {f"no_{chance.choice(_ARGUMENTS)}": chance.choice(_VALUES)}
    return json.dumps({"do": chance.choice(_COMMANDS)} | wrong)


def _wrong_type(chance: random.Random) -> str:
    wrong = {
        "side": 2,
        "pixel": [1, "2"],
        "view": -1,
        "id": 1.5,
        "a": ["r1"],
        "set": [],
        "images": 1,
    }
    name = chance.choice(list(wrong))
    return json.dumps({"do": chance.choice(_COMMANDS), name: wrong[name]})


def _cut_short(chance: random.Random) -> str:
    whole = json.dumps({"do": "pick", "side": 0, "pixel": [10, 20], "view": 3})
    return whole[: chance.randrange(1, len(whole))]


def _not_a_number(chance: random.Random) -> str:
    number = chance.choice(("NaN", "Infinity", "1e999"))
    return f'{{"do":"cursor","side":0,"pixel":[{number},1]}}'


_KINDS: tuple[Callable[[random.Random], str | bytes], ...] = (
    *(_noise, _bytes, _no_object, _deep, _no_command, _do_is_no_text),
    *(_wrong_argument, _wrong_type, _cut_short, _not_a_number),
)
