"""What the vehicle as it was recorded knows at each step, under the names of what its recordings hold.

DronePropA's matrices are in FLU; here everything is in FRD and NED, as everywhere in the plant.
"""

from dataclasses import dataclass

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray

__all__ = ["FIXED_COLUMNS", "RecordedLog", "log_columns"]

FIXED_COLUMNS = 49  # before the motors' telemetry


def log_columns(rotors: int) -> int:
    """Columns of `PlantSamples.log` for so many rotors."""
    return FIXED_COLUMNS + rotors


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLog:
    """n steps; k is the IMU, 0 or 1.

    angle: (n, 2, 3) each IMU's estimate [rad]; its yaw is the gyro's integral and drifts.
    rate, acceleration: (n, 2, 3) filtered body rates [rad/s] and their slopes [rad/s^2].
    gyro, accel: (n, 2, 3) raw readings.
    torque_asked, torque: (n, 3) before and after the limit [N m].
    thrust: (n,) commanded [N], trim included.
    pid: (n, 4) roll and pitch reference before their limit [rad], thrust deviation [N], yaw-rate reference [rad/s].
    desired, pose: (n, 4) set-point and cameras: north, east, down [m], yaw [rad].
    esc: (n, r) reported rotor speeds [rad/s], which read too high; NaN before the first telemetry frame.
    """

    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    gyro: FloatArray
    accel: FloatArray
    torque_asked: FloatArray
    torque: FloatArray
    thrust: FloatArray
    pid: FloatArray
    desired: FloatArray
    pose: FloatArray
    esc: FloatArray

    @staticmethod
    def of(log: FloatArray) -> "RecordedLog":
        """From `PlantSamples.log`. Raises UsageError where the vehicle keeps none."""
        if log.shape[1] <= FIXED_COLUMNS:
            raise UsageError("this vehicle keeps no such log: fly qdrone2-recorded, or one with a [recorded] table")
        angle, rate, acceleration, gyro, accel = (log[:, at : at + 6].reshape(-1, 2, 3) for at in range(0, 30, 6))
        return RecordedLog(
            angle=angle,
            rate=rate,
            acceleration=acceleration,
            gyro=gyro,
            accel=accel,
            torque_asked=log[:, 30:33],
            torque=log[:, 33:36],
            thrust=log[:, 36],
            pid=log[:, 37:41],
            desired=log[:, 41:45],
            pose=log[:, 45:FIXED_COLUMNS],
            esc=log[:, FIXED_COLUMNS:],
        )
