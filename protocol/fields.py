"""Types of plain fields in messages: what a name, a count or a length in metres may be."""

from typing import Annotated

from pydantic import Field

from protocol.keys import NAME_PATTERN

EPOCH_PATTERN = r"^[0-9a-f]{12}$"

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Epoch = Annotated[str, Field(pattern=EPOCH_PATTERN)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=2000)]
