"""Under which conditions a vehicle flies, ten times a second: what the envelope of a baseline is made of.

They are of commands and slow signals, which a damaged rotor does not move. One that is not sent is nan: no limit.

    yaw rate = min(|r|, max over 2 s of |d psi/dt|)      r: gyro, mean of the bin;  psi: commanded heading, over 0.1 s

Where psi steps (PX4 offboard) r tells how fast; a damaged rotor may yaw the vehicle, and psi limits that.
"""

from enum import StrEnum

BIN_S = 0.1  # our choice


class Condition(StrEnum):
    """What is watched. The comment gives its unit and how a bin has it."""

    TILT = "tilt"  # rad, of the mean commanded roll and pitch of 5 s: steady wind, or a steady acceleration
    THROTTLE = "throttle"  # 0..1, mean collective set-point
    COMMANDED_RATE = "commanded rate"  # rad/s, largest of roll and pitch
    # rad/s^2: the largest change since the bin before, of the three axes, over 0.1 s
    COMMANDED_ACCELERATION = "commanded angular acceleration"
    YAW_ACCELERATION = "commanded yaw acceleration"  # rad/s^2, likewise of yaw
    YAW_RATE = "yaw rate"  # rad/s, mean measured one, and not more than the heading was commanded to move in 2 s
    HEIGHT = "height"  # m above take-off, least


TRIM_CONDITIONS = frozenset({Condition.TILT, Condition.THROTTLE, Condition.YAW_RATE, Condition.HEIGHT})
TRIM_MEMORY_S = 1.0  # of these conditions
