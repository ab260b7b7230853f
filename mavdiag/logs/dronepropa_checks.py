"""Does a DronePropA recording follow the table of its rows? The file is asked, for the table is pieced together.

Each check looks at the samples in flight. One that contradicts the table refuses the file; one that cannot be made, or
that leaves something open, is a note. All limits are our choice: they are wide, for they tell units, signs and orders
apart, not flights.
"""

import numpy as np

from mavdiag.airframe.layout import layout_named
from mavdiag.errors import InputError
from mavdiag.logs.dronepropa_rows import Recording
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["check", "speeds_are_certain"]

MIN_FLIGHT_S = 2.0  # less cannot be checked
GRAVITY_M_S2 = (9.0, 10.6)  # of the mean specific force
WINDOW_S = 0.1  # over which the gyro is integrated
SLOPE = (0.7, 1.4)  # of the attitude's change on the integrated gyro
CLEAR = 0.5  # correlation that settles a sign
STRAIGHT = 0.9  # correlation that settles a scale: noise on the gyro alone lowers the slope below it
SAME = 0.99  # correlation of two records of one signal
LINES_HZ = ((125.0, 175.0), (250.0, 350.0))  # hover, by the accelerometer of 115 of 130 flights, and its double
FLOOR_HZ = (60.0, 450.0)
LINE_RATIO = 5.0  # peak over the median of the spectrum
LINE_SEGMENT = 1024  # samples of a spectrum: 1 Hz at 1 kHz

_AXES = ("roll", "pitch", "yaw")
_RULE = "the rows are not those of DronePropA"


def check(recording: Recording) -> tuple[str, ...]:
    """What could not be confirmed, one sentence each. Raises InputError if the file contradicts the table."""
    dt_s = float(np.median(np.diff(recording.qdrone[:, 0])))
    flying = recording.flying
    if int(flying.sum()) * dt_s < MIN_FLIGHT_S:
        _gravity(recording.force())
        return (f"less than {MIN_FLIGHT_S:g} s in flight: signs and motor order could not be checked",)
    _gravity(recording.force()[flying])
    notes = [*_turning(recording, flying, dt_s), *_order(recording, flying), *_line(recording.force()[flying], dt_s)]
    _references(recording, flying, dt_s)
    if not speeds_are_certain(recording):
        notes.append("rows 20 to 23 are not rows 53, 51, 49 and 47: the speeds of the ESCs were left out")
    return tuple(notes)


def speeds_are_certain(recording: Recording) -> bool:
    """Whether the copies of the motor commands stand beside the ESCs' rows in the order of the table."""
    rows = recording.flying
    if not rows.any():
        return False
    commands, copies = recording.outputs()[rows], recording.on_board(53, 51, 49, 47)[rows]
    return all(_fit(commands[:, i], copies[:, i])[1] > SAME for i in range(4))


def _gravity(force: FloatArray) -> None:
    """At rest and in mean flight the specific force is 9.8 m/s^2, upwards: -9.8 along z of FRD."""
    known = force[np.isfinite(force).all(axis=1)]
    mean = known.mean(axis=0) if len(known) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    if not GRAVITY_M_S2[0] <= size <= GRAVITY_M_S2[1]:
        raise InputError(f"the mean specific force is {size:.2f} m/s^2, not 9.8 (rows 30 to 32): {_RULE}")
    if mean[2] > -CLEAR * size:
        raise InputError(f"gravity is not along the vertical axis (row 32 has {-mean[2]:.2f} m/s^2, not +9.8): {_RULE}")


def _turning(recording: Recording, flying: BoolArray, dt_s: float) -> list[str]:
    """The attitude estimates change by what the gyro integrates to, axis by axis.

    dphi   = p + tan(theta) (q sin(phi) + r cos(phi))
    dtheta = q cos(phi) - r sin(phi)
    dpsi   = (q sin(phi) + r cos(phi)) / cos(theta)
    """
    angle = recording.imu_attitude()
    changes = _change(angle, flying, dt_s)
    notes: list[str] = []
    for name, rate in (("raw", recording.raw_rate()), ("filtered", recording.filtered_rate())):
        phi, theta = angle[:, 0], angle[:, 1]
        p, q, r = rate.T
        turn = q * np.sin(phi) + r * np.cos(phi)
        euler = np.column_stack((p + np.tan(theta) * turn, q * np.cos(phi) - r * np.sin(phi), turn / np.cos(theta)))
        for axis, change, integral in zip(_AXES, changes, _integral(euler, flying, dt_s), strict=True):
            slope, correlation = _fit(integral, change)
            if abs(correlation) < CLEAR:
                notes.append(f"too little {axis} motion to check the sign of the {name} {axis} gyro")
            elif correlation < 0 or (correlation > STRAIGHT and not SLOPE[0] <= slope <= SLOPE[1]):
                raise InputError(f"the {name} {axis} gyro is not the {axis} estimate's slope (x {slope:.3g}): {_RULE}")
            elif correlation <= STRAIGHT:
                notes.append(f"too little {axis} motion to check the scale of the {name} {axis} gyro")
    return notes


def _windows(flying: BoolArray, dt_s: float) -> tuple[IntArray, int]:
    """First rows of the windows that begin and end in flight, and their length in rows."""
    width = max(1, round(WINDOW_S / dt_s))
    first = np.arange(0, len(flying) - width, width)
    return first[flying[first] & flying[first + width]], width


def _change(angle: FloatArray, flying: BoolArray, dt_s: float) -> FloatArray:
    """What angles (n, k) change by over each window in flight, (k, windows), within half a turn."""
    first, width = _windows(flying, dt_s)
    change: FloatArray = (angle[first + width] - angle[first] + np.pi) % (2 * np.pi) - np.pi
    return change.T


def _integral(rate: FloatArray, flying: BoolArray, dt_s: float) -> FloatArray:
    """What rates (n, k) integrate to over each window in flight, (k, windows)."""
    first, width = _windows(flying, dt_s)
    total = np.concatenate((np.zeros((1, rate.shape[1])), np.cumsum(np.nan_to_num(rate), axis=0))) * dt_s
    integral: FloatArray = total[first + width] - total[first]
    return integral.T


def _references(recording: Recording, flying: BoolArray, dt_s: float) -> None:
    """Roll and pitch follow their references, and the motion capture's yaw changes as the IMU's, which drifts."""
    angle, reference = recording.attitude(), recording.attitude_setpoint()
    captured, estimated = (_change(yaw, flying, dt_s) for yaw in (angle[:, 2:], recording.imu_attitude()[:, 2:]))
    pairs = (
        ("roll reference (row 9)", reference[flying, 0], angle[flying, 0]),
        ("pitch reference (row 10)", reference[flying, 1], angle[flying, 1]),
        ("motion capture's yaw (row 25)", captured[0], estimated[0]),
    )
    for name, one, other in pairs:
        if _fit(one, other)[1] < -CLEAR:
            raise InputError(f"the {name} runs against the IMU's estimate: {_RULE}")


def _order(recording: Recording, flying: BoolArray) -> list[str]:
    """The motor commands mix into the torque commands of roll and pitch, which settles the order of all four."""
    outputs, torque = recording.outputs()[flying], recording.torque()[flying]
    mixed = outputs @ layout_named("qdrone2").unmixing.T
    notes = []
    for i, axis in enumerate(_AXES[:2]):
        _, correlation = _fit(torque[:, i], mixed[:, i])
        if correlation == 0.0:
            notes.append(f"no {axis} torque command to check the order of the motors with")
        elif correlation < CLEAR:
            raise InputError(f"rows 20 to 23 do not mix into the {axis} torque: the motors are in another order")
    return notes


def _line(force: FloatArray, dt_s: float) -> list[str]:
    """The rotors' line, or its double, stands out of the accelerometer's spectrum."""
    from scipy.signal import welch  # not at the start of a program that reads no such file

    known = force[np.isfinite(force).all(axis=1)]
    if len(known) < LINE_SEGMENT:
        return ["too few samples of the accelerometer to look for the rotors' line"]
    hz, density = welch(known, 1 / dt_s, nperseg=LINE_SEGMENT, axis=0)
    power = density.sum(axis=1)
    floor = float(np.median(power[_within(hz, FLOOR_HZ)])) if _within(hz, FLOOR_HZ).any() else 0.0
    peaks = [float(power[_within(hz, band)].max(initial=0.0)) for band in LINES_HZ]
    if max(peaks) > LINE_RATIO * floor > 0:
        return []
    return ["no rotor line near 150 or 300 Hz in the accelerometer: another speed, or another vehicle"]


def _within(hz: FloatArray, band: tuple[float, float]) -> BoolArray:
    return np.asarray((hz >= band[0]) & (hz <= band[1]), dtype=np.bool_)


def _fit(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope of y on x and their correlation over what is finite, both (n,); zeros if one of them stands still."""
    known = np.isfinite(x) & np.isfinite(y)
    if int(known.sum()) < 3:
        return 0.0, 0.0
    dx, dy = x[known] - x[known].mean(), y[known] - y[known].mean()
    xx, yy, xy = float(dx @ dx), float(dy @ dy), float(dx @ dy)
    if not (xx > 0 and yy > 0 and np.isfinite(xx * yy)):
        return 0.0, 0.0
    return xy / xx, xy / float(np.sqrt(xx * yy))
