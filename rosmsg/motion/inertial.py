"""`sensor_msgs/Imu`: what an accelerometer says of up, where it is at rest."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg.camera_infos import frame_of
from fleetpose.rosmsg.stamps import stamp_ns

Floats = npt.NDArray[np.float64]

GRAVITY_M_S2 = 9.81
_REST_M_S2 = 0.4  # bias of a cheap accelerometer, and gravity from place to place
_REST_RAD_S = 0.1


@dataclass(frozen=True, eq=False)
class InertialReading:
    """One sample in the sensor's own frame.

    Attributes:
        stamp_ns: UTC of the robot's clock.
        acceleration: (3,) m/s2, as REP-145 has it: at rest it points up.
        turning: (3,) rad/s; None where there is no gyroscope.
        frame: the sensor's.
    """

    stamp_ns: int
    acceleration: Floats
    turning: Floats | None
    frame: str

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing but gravity is felt, as far as one sample tells."""
        felt = float(np.linalg.norm(self.acceleration))
        still = self.turning is None or float(np.linalg.norm(self.turning)) < _REST_RAD_S
        return abs(felt - GRAVITY_M_S2) < _REST_M_S2 and still


def inertial_reading(message: Any) -> InertialReading | None:
    """Of a message; None where it says that it has no accelerometer.

    Raises:
        CodecError: its numbers are none.
    """
    if message.linear_acceleration_covariance[0] == -1:
        return None
    acceleration = _xyz(message.linear_acceleration)
    has_gyroscope = message.angular_velocity_covariance[0] != -1
    turning = _xyz(message.angular_velocity) if has_gyroscope else None
    return InertialReading(stamp_ns(message), acceleration, turning, frame_of(message))


def _xyz(vector: Any) -> Floats:
    xyz = np.array((vector.x, vector.y, vector.z), np.float64)
    if not np.isfinite(xyz).all():
        raise CodecError(f"an Imu that feels {xyz.tolist()}")
    return xyz
