"""What a robot is called in the fleet."""

import re

_LONGEST = 32


def name_of(namespace: str) -> str:
    """A robot's name by its namespace, of which the innermost counts: `/site/Alpha` is `alpha`.
    Empty where nothing of it can stand in a name.
    """
    innermost = namespace.strip("/").rpartition("/")[2]
    return re.sub(r"[^a-z0-9_-]+", "_", innermost.lower()).strip("_")[:_LONGEST]
