"""The rows of a DronePropA recording, by number, and what they are in SI units and FRD.

The published table (Data in Brief, 10.1016/j.dib.2025.111589) names about half of the rows. The others follow from the
manufacturer's public hover-test model for the QDrone 2 (Quanser Academic Resources, QD2_DroneStack_PID_2021a) and from
published statistics of the recordings. Rows are numbered from 1, as there. The manufacturer's frame is x forward, y
left, z up; vectors and angles about y and z change their sign on the way to FRD.

Motors. Rows 20 to 23 are the commands of motors 1 to 4: rear right, front right, rear left, front left, as in the
thesis. Their copies are rows 53, 51, 49 and 47; the published table has rows 49 and 51 the other way round.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.telemetry import BoolArray, FloatArray, IntArray
from mavdiag.units import NS_PER_S, RPM

__all__ = ["FLIGHT_STATE", "ROWS", "Recording", "full_thrust_n"]

#: The matrices and how many rows each has.
ROWS = {"QDrone_data": 56, "commander_data": 37, "stabilizer_data": 21}

FRD: FloatArray = np.array([1.0, -1.0, -1.0])  # from x forward, y left, z up
FLIGHT_STATE = 5  # of the commander's state machine: after arming, throttle up and take-off, before landing

ANGLE_GAIN_PER_S: FloatArray = np.array([12.0, 12.0, 2.0])  # rate command on angle error; yaw: on its
RATE_GAIN: FloatArray = np.array([0.1, 0.1, 0.0])  # rate reference, less a share of the measured rate
MAX_RATE_RAD_S = 10 * np.pi / 3
MAX_TORQUE_NM: FloatArray = np.array(
    [1.0915, 0.8984, 0.0984]
)  # saturation of the stabilizer: full scale of roll, pitch, yaw
THRUST_N_PER_V = (0.03616, 0.117, -0.01215)  # F = a V^2 + b V + c of one motor, in the manufacturer's mixer
NOMINAL_V = 14.8  # a battery of four cells: the voltage at which thrust 1 is full thrust (our choice)
KV_RPM_PER_V = 1300.0
POLE_CORRECTION = 12 / 14  # the log takes 12 poles; 14 bring the hover from 177 Hz to the accelerometer's 148-154 Hz


def full_thrust_n(volt: float = NOMINAL_V) -> float:
    """Thrust of all four motors at full duty [N].

    >>> round(full_thrust_n(), 2)
    38.56
    """
    a, b, c = THRUST_N_PER_V
    return 4 * (a * volt**2 + b * volt + c)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The three matrices, transposed to one row a sample: (n, 56), (n, 37) and (n, 21). Values that cannot be are NaN.

    All methods give (n, k) arrays in SI units and FRD unless they say otherwise.
    """

    qdrone: FloatArray
    commander: FloatArray
    stabilizer: FloatArray

    def __len__(self) -> int:
        return len(self.qdrone)

    def on_board(self, *rows: int) -> FloatArray:
        """Rows of QDrone_data by number, as recorded."""
        return self.qdrone[:, [row - 1 for row in rows]]

    def commanded(self, *rows: int) -> FloatArray:
        """Rows of commander_data by number, as recorded."""
        return self.commander[:, [row - 1 for row in rows]]

    def stabilized(self, *rows: int) -> FloatArray:
        """Rows of stabilizer_data by number, as recorded."""
        return self.stabilizer[:, [row - 1 for row in rows]]

    @property
    def t_ns(self) -> IntArray:
        """(n,) time since the recording began."""
        return np.rint(self.qdrone[:, 0] * NS_PER_S).astype(np.int64)

    @property
    def flying(self) -> BoolArray:
        """(n,) the commander was in flight: not on the ground, taking off or landing."""
        return np.asarray(self.commander[:, 1] == FLIGHT_STATE, dtype=np.bool_)

    def raw_rate(self) -> FloatArray:
        """Gyro of the first IMU, unfiltered [rad/s]."""
        return self.on_board(27, 28, 29) * FRD

    def filtered_rate(self) -> FloatArray:
        """The same behind the flight software's low-pass, 120 rad/s of second order [rad/s]."""
        return self.on_board(5, 6, 7) * FRD

    def force(self) -> FloatArray:
        """Accelerometer of the first IMU [m/s^2]."""
        return self.on_board(30, 31, 32) * FRD

    def imu_attitude(self) -> FloatArray:
        """Roll, pitch and yaw that the first IMU estimates [rad]; its yaw drifts."""
        return self.on_board(2, 3, 4) * FRD

    def attitude(self) -> FloatArray:
        """Roll and pitch as the controller had them, the mean of both IMUs, and the motion capture's yaw [rad]."""
        mean = 0.5 * (self.on_board(2, 3) + self.on_board(11, 12))
        return np.column_stack((mean, self.commanded(25))) * FRD

    def attitude_setpoint(self) -> FloatArray:
        """Roll and pitch references as the stabilizer used them, and the desired yaw [rad]."""
        return np.column_stack((self.stabilized(9, 10), self.commanded(29))) * FRD

    def rate_setpoint(self) -> FloatArray:
        """Commanded body rates, which are not recorded, from what the manufacturer's cascade does [rad/s].

        Roll, pitch: 12 (reference - angle) - 0.1 rate; yaw: 2 reference; each within 10 pi/3.
        """
        angle = 0.5 * (self.on_board(2, 3, 4) + self.on_board(11, 12, 13))
        rate = 0.5 * (self.on_board(5, 6, 7) + self.on_board(14, 15, 16))
        angle[:, 2] = 0.0
        command = ANGLE_GAIN_PER_S * (self.stabilized(9, 10, 11) - angle) - RATE_GAIN * rate
        return np.clip(command, -MAX_RATE_RAD_S, MAX_RATE_RAD_S) * FRD

    def torque(self) -> FloatArray:
        """Torque command behind its saturation, of full scale."""
        return self.stabilized(19, 20, 21) / MAX_TORQUE_NM * FRD

    def thrust(self) -> FloatArray:
        """Thrust command of `full_thrust_n()`, 0..1."""
        return np.clip(self.stabilized(8) / full_thrust_n(), 0.0, 1.0)

    def outputs(self) -> FloatArray:
        """Motor commands, fraction of the battery's voltage; rotors in the thesis's order."""
        return self.on_board(20, 21, 22, 23)

    def rotor_speed(self) -> FloatArray:
        """Speeds that the ESCs measured [rad/s]; NaN until a rotor's first telemetry. Rotors in the thesis's order.

        The recorded number is speed / (1300 rpm/V x voltage) with 12 poles.
        """
        share = self.on_board(54, 52, 50, 48)
        return share * self.on_board(24) * (KV_RPM_PER_V * POLE_CORRECTION * RPM)

    def height(self) -> FloatArray:
        """Height by the motion capture [m]."""
        return self.commanded(24)

    def voltage(self) -> FloatArray:
        """Battery [V]."""
        return self.on_board(24)
