"""One row of `pose-eval cameras`: a figure beside its limit."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Attempt:
    """One thing tried.

    Attributes:
        name: of it.
        met: whether what came of it is right.
        says: what came of it.
    """

    name: str
    met: bool
    says: str


@dataclass(frozen=True)
class Bar:
    """One demand.

    Attributes:
        name: of it.
        attempts: what was tried; all count alike.
        least: of them that must be right; None: all.
        unit: what is counted.
    """

    name: str
    attempts: list[Attempt] = field(default_factory=list)
    least: int | None = None
    unit: str = "right"

    @property
    def count(self) -> int:
        """How many are right."""
        return sum(one.met for one in self.attempts)

    @property
    def limit(self) -> int:
        """How many must be."""
        return len(self.attempts) if self.least is None else self.least

    @property
    def is_met(self) -> bool:
        """Whether enough are right, of some."""
        return bool(self.attempts) and self.count >= self.limit

    @property
    def failed(self) -> list[Attempt]:
        """Those that are not right."""
        return [one for one in self.attempts if not one.met]
