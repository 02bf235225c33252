"""Types of plain fields in messages: what a name, a count or a length in metres may be."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, FailFast, Field

from fleetpose.protocol.keys import NAME_PATTERN
from fleetpose.protocol.text import one_line

EPOCH_PATTERN = r"^[0-9a-f]{12}$"

T = TypeVar("T")


def _printable(value: Any) -> Any:
    return one_line(value) if isinstance(value, str) else value


Clock = Literal["live", "recorded"]
Verdict = Literal["verified", "plausible", "ambiguous", "rejected"]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Epoch = Annotated[str, Field(pattern=EPOCH_PATTERN)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Stamp = Annotated[int, Field(gt=-(2**62), lt=2**62)]
"""UTC nanoseconds of a measurement, up to the year 2116."""
Moment = Annotated[int, Field(ge=-(2**63), lt=2**63)]
"""UTC nanoseconds, of a stamp and a duration together."""
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Text = Annotated[str, BeforeValidator(_printable), Field(max_length=2000)]
"""One line that a terminal can show; longer texts are cut, not refused."""
Many = Annotated[tuple[T, ...], Field(max_length=100_000), FailFast()]
"""Any number of things, within reason; the first wrong one ends the reading."""
