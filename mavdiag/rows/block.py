"""The uniform rows that everything after the alignment works on."""

from dataclasses import dataclass

from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["Block"]


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive rows of one segment, on a uniform grid of period `dt_s`.

    t_ns: (n,) vehicle time. setpoint: (n, 3) commanded roll, pitch, yaw [rad]. rate: (n, 3) gyro [rad/s].
    force: (n, 3) accelerometer [m/s^2]. torque: (n, 3) torque command, rate_setpoint: (n, 3) [rad/s],
    thrust, height, armed: (n,), vibration: (n, 3) [m/s^2], actuator: (n, outputs); nan where the vehicle sends none.
    valid: (n,) False where a row must not be judged. segment: changes after every break.
    """

    segment: int
    dt_s: float
    t_ns: IntArray
    setpoint: FloatArray
    rate: FloatArray
    force: FloatArray
    torque: FloatArray
    rate_setpoint: FloatArray
    thrust: FloatArray
    height: FloatArray
    armed: FloatArray
    vibration: FloatArray
    actuator: FloatArray
    valid: BoolArray

    def __len__(self) -> int:
        return len(self.t_ns)

    def rows(self, first: int, stop: int, segment: int | None = None) -> "Block":
        """Rows [first, stop) as a block of their own, of another segment if asked."""
        cut = slice(first, stop)
        return Block(
            self.segment if segment is None else segment,
            self.dt_s,
            self.t_ns[cut],
            self.setpoint[cut],
            self.rate[cut],
            self.force[cut],
            self.torque[cut],
            self.rate_setpoint[cut],
            self.thrust[cut],
            self.height[cut],
            self.armed[cut],
            self.vibration[cut],
            self.actuator[cut],
            self.valid[cut],
        )
