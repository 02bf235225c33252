"""What is wrong with robots, as it stands now."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from fleetpose.protocol.messages import Alarm


@dataclass
class Alarms:
    """Alarms about calibrations and clocks.

    Attributes:
        standing: those of now.
        distortions: those of them that say that a robot's depths bend.
    """

    standing: tuple[Alarm, ...] = ()
    distortions: tuple[Alarm, ...] = ()
    _told: set[tuple[str, str]] = field(default_factory=set)

    def keep_distortions(self, alarms: Sequence[Alarm]) -> None:
        """What the newest comparisons of depths say."""
        self.distortions = tuple(alarms)

    def renew(self, alarms: Sequence[Alarm]) -> list[Alarm]:
        """These stand now; of them, those that were no event yet."""
        self.standing = tuple(alarms)
        new = [alarm for alarm in alarms if (alarm.robot, alarm.kind) not in self._told]
        self._told.update((alarm.robot, alarm.kind) for alarm in new)
        return new

    def forget(self, robot: str) -> None:
        """A robot has another calibration: what was told of it may be told again."""
        self._told = {of for of in self._told if of[0] != robot}
