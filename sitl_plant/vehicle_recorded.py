"""What a vehicle file says of a vehicle that is flown "as it was recorded": the table `[recorded]`.

It replaces the thesis's cascade and its one IMU by the controller, the two IMUs, the motors' voltage map and the ESC
telemetry of the QDrone 2 that flew the public recordings (DronePropA, Mendeley Data 10.17632/ftdyxrr3c5.1). Every
number and its source stand in `qdrone2-recorded.toml`.
"""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from sitl_plant.fields import STRICT, Finite, NotNegative, Positive, PositiveVector, Vector

__all__ = [
    "Esc",
    "Feedback",
    "Gains",
    "GroundPhase",
    "Motors",
    "Recorded",
    "Sensors",
    "Specimen",
    "Vibration",
]

Range = tuple[Positive, Positive]
Gain3 = tuple[NotNegative, NotNegative, NotNegative]


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Gains:
    """The manufacturer's cascade. pid rows are P, D, I; D acts on the measured rate."""

    angle: Positive
    rate_damping: NotNegative
    yaw_rate: Positive
    rate_limit_rad_s: Positive
    torque_per_rate: PositiveVector
    torque_per_acceleration: Gain3
    torque_limit_n_m: PositiveVector
    horizontal_pid: Gain3
    altitude_pid: Gain3
    yaw_pid: Gain3
    trim_n: Positive
    tilt_limit_rad: Positive
    integral_limit: PositiveVector


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Feedback:
    """Second-order filters, natural frequency [rad/s] and damping ratio, and the complementary filter's gains."""

    rate: Range
    accel: Range
    velocity: Range
    complementary_p: NotNegative
    complementary_i: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Motors:
    """Thrust of a rotor by motor voltage, F = a V^2 + b V + c, as the controller believes.

    thrust_over_command: what the rotor really lifts at that voltage.
    command_delay_s: from the duty to the voltage.
    """

    thrust_map: tuple[Positive, NotNegative, Finite]
    thrust_over_command: Positive
    command_delay_s: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Sensors:
    """Both IMUs: IMU 0 is the one that a link carries."""

    positions_m: tuple[Vector, Vector]
    gyro_period_s: Positive
    gyro_filter_hz: Positive
    gyro_range_rad_s: Positive
    gyro_lsb_rad_s: Positive
    gyro_bias_rms_rad_s: NotNegative
    accel_filter_hz: Positive
    accel_range_m_s2: Positive
    accel_lsb_m_s2: Positive


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Vibration:
    """What the IMU's mount adds in hover. All levels are rms as recorded, behind filter and hold.

    gyro_line: lowest and highest level of the roll gyro's line at one per revolution among specimens [rad/s].
    gyro_broad: of its broad part, 50 to 100 Hz [rad/s].
    gyro_axes, accel_axes: levels of the axes; of the gyro relative to roll, of the accelerometer line [m/s^2].
    accel_broad: of all axes, 50 to 100 Hz [m/s^2].
    broad_corner_hz: the broad part is white above it.
    second_imu: levels of IMU 1 relative to IMU 0.
    second_harmonic: level at two per revolution relative to one per revolution, before the filter.
    session_rms: how much the line differs from flight to flight, of its logarithm.
    """

    gyro_line: Range
    gyro_broad: Range
    gyro_axes: PositiveVector
    accel_axes: PositiveVector
    accel_broad: NotNegative
    broad_corner_hz: Positive
    second_imu: Positive
    second_harmonic: NotNegative
    session_rms: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Esc:
    """Telemetry of the motors' controllers: one motor after the other, held until the next.

    frame_s: from one motor to the next.
    over_read: reported over true speed.
    first_s: flight time of the first frame in a flight from the ground.
    """

    frame_s: Positive
    over_read: Positive
    first_s: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class GroundPhase:
    """When the motors start and lift, and what they are commanded to lift in between."""

    arm_s: Positive
    lift_s: Positive
    thrust_n: Positive


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Specimen:
    """A drone whose levels are known, by the name of its airframe. gyro_bias_roll: of IMU 0 and 1 [rad/s]."""

    name: str
    gyro_line: Positive
    gyro_broad: Positive
    gyro_bias_roll: tuple[Finite, Finite]
    second_harmonic: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Recorded:
    """The whole set."""

    gains: Gains
    feedback: Feedback
    motors: Motors
    sensors: Sensors
    vibration: Vibration
    esc: Esc
    ground: GroundPhase
    specimens: Annotated[tuple[Specimen, ...], Field(max_length=100)] = ()
