"""Labels over places worth a pick: typing one puts the cursor there."""

from collections.abc import Sequence
from dataclasses import dataclass

from fleetpose.hmi_client.model.records import PixelUV

LETTERS = "asdfghjklqwertyuiopzxcvbnm"  # the hand's rest first
MOST = 120


@dataclass(frozen=True)
class Hints:
    """Places by their labels, and what has been typed of one."""

    places: dict[str, PixelUV]
    typed: str = ""

    @classmethod
    def of(cls, places: Sequence[PixelUV]) -> "Hints":
        """One letter each, or two where there are more places than letters."""
        return cls(dict(zip(labels(len(places)), places, strict=True)))

    def type(self, letter: str) -> "Hints":
        """With one more letter; a letter that no label goes on with changes nothing."""
        typed = self.typed + letter
        left = {label: place for label, place in self.places.items() if label.startswith(typed)}
        return Hints(left, typed) if left else self

    @property
    def chosen(self) -> PixelUV | None:
        """The place whose label has been typed in full."""
        return self.places.get(self.typed)


def labels(count: int) -> list[str]:
    """So many labels, none of which begins another."""
    if count <= len(LETTERS):
        return list(LETTERS[:count])
    both = [first + second for first in LETTERS for second in LETTERS]
    return both[:count]
