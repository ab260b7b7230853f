"""Where a link carries the vibration of the rotors: the corner of the high-pass that the unbalance monitor uses."""

import math

from mavdiag.errors import InputError

CORNER_HZ = 60.0  # METHOD section 4
CORNER_SHARE = 0.36  # of the rotor's frequency, where that is lower: 60 Hz at the thesis's 167 Hz (our choice)
BAND_SHARE = 0.25  # of the sample rate: corner where the stream is too slow for the line itself (our choice)
FULL_RATE_HZ = 400.0  # from here on the line at one per revolution is seen as it is (METHOD section 4)
LEAST_RATE_HZ = 100.0  # below it nothing above the flight's own motion is left (METHOD section 4)
SLACK = 0.98  # a nominal rate is met within 2 % (our choice)


def corner_of(rate_hz: float, imu_corner_hz: float | None = None, hover_rad_s: float | None = None) -> float:
    """Corner of the high-pass on a link [Hz]. rate_hz: of the IMU stream; imu_corner_hz: of the low-pass in it, None if
    there is none; hover_rad_s: rotor speed at hover, if known.

    Raises InputError if the link does not carry a rotor's vibration.
    """
    if rate_hz < SLACK * LEAST_RATE_HZ:
        raise InputError(
            f"the IMU comes at {rate_hz:.3g} Hz; vibration needs {LEAST_RATE_HZ:.0f} Hz, better {FULL_RATE_HZ:.0f}"
        )
    line_hz = math.inf if hover_rad_s is None else hover_rad_s / (2 * math.pi)
    corner_hz = min(CORNER_HZ, CORNER_SHARE * line_hz) if carries_line(rate_hz) else BAND_SHARE * rate_hz
    passed_hz = max(corner_hz, min(CORNER_HZ, line_hz))  # what the stream must carry
    if imu_corner_hz is not None and imu_corner_hz < passed_hz:
        raise InputError(f"the IMU stream is low-passed at {imu_corner_hz:g} Hz, which takes the vibration out of it")
    if hover_rad_s is not None:
        folded_hz = abs(line_hz - rate_hz * round(line_hz / rate_hz))
        if folded_hz < corner_hz:
            how = "fold to" if folded_hz < line_hz else "are"
            raise InputError(
                f"at {rate_hz:.3g} Hz the rotors' {line_hz:.3g} Hz {how} {folded_hz:.3g} Hz, among the flight itself"
            )
    return corner_hz


def carries_line(rate_hz: float) -> bool:
    """Whether the line at one per revolution is seen as it is, and not folded."""
    return rate_hz >= SLACK * FULL_RATE_HZ
