"""Recordings of the QDrone 2 in DronePropA: MATLAB files with QDrone_data, commander_data and stabilizer_data.

DronePropA (Mendeley Data, 10.17632/ftdyxrr3c5.1, CC BY 4.0) holds 130 flights of three QDrone 2, healthy and with the
thesis's nine faults, at 1 kHz. No raw flight was at hand when this was written: it is tested on made files of the same
layout, and every file is asked whether it follows the table of its rows (`_check`).

Rows. The published table (Data in Brief, 10.1016/j.dib.2025.111589) names about half of them. The others follow from
the manufacturer's public hover-test model for the QDrone 2 (Quanser Academic Resources, QD2_DroneStack_PID_2021a) and
from published statistics of the recordings. Rows are numbered from 1, as there. The manufacturer's frame is x forward,
y left, z up; vectors and angles about y and z change their sign on the way to FRD.

Motors. Rows 20 to 23 are the commands of motors 1 to 4: rear right, front right, rear left, front left, as in the
thesis. Their copies are rows 53, 51, 49 and 47; the published table has rows 49 and 51 the other way round.

Which gyro. BODY_RATE is the unfiltered gyro of the first IMU (rows 27 to 29). The thesis's residual fits it: from the
published noise of the healthy flights a one-step prediction leaves 0.8 to 1.6 mrad/s behind a Savitzky-Golay window of
101 samples, as Fig 5.7 shows, and 20 times less on the filtered gyro (rows 5 to 7). That one is read on request, under
a profile of its own, since a baseline of one says nothing of the other.

Flight. ARMED is true in the commander's state 5 only, so that idling, take-off and landing are never judged. On the
ground the motors turn for seven seconds with a limit cycle of the yaw torque at 24 Hz.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mavdiag.airframe.layout import layout_named
from mavdiag.errors import InputError, UsageError
from mavdiag.logs.log import LogKind, read_bytes, sha256_of
from mavdiag.logs.matlab import is_mat, read_matrices
from mavdiag.logs.records import recorded
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Log, Signal, Telemetry
from mavdiag.units import NS_PER_S, RPM

PROFILE = "dronepropa"
FILTERED_PROFILE = "dronepropa-filtered"
MAX_TIME_S = 1e6  # 11 days: anything later is damage
MAX_VALUE = 1e9  # no row comes near it: more is damage (our choice)
MIN_SAMPLES = 20
SKEW_S = 0.002  # times of the matrices that differ by more are worth a note (our choice)

#: The matrices and how many rows each has.
ROWS = {"QDrone_data": 56, "commander_data": 37, "stabilizer_data": 21}

FRD: FloatArray = np.array([1.0, -1.0, -1.0])  # from x forward, y left, z up
FLIGHT_STATE = 5  # of the commander's state machine: after arming, throttle up and take-off, before landing

ANGLE_GAIN_PER_S: FloatArray = np.array([12.0, 12.0, 2.0])  # rate command on angle error; yaw: on its
RATE_GAIN: FloatArray = np.array([0.1, 0.1, 0.0])  # rate reference, less a share of the measured rate
MAX_RATE_RAD_S = 10 * np.pi / 3
MAX_TORQUE_NM: FloatArray = np.array([1.0915, 0.8984, 0.0984])  # saturation of the stabilizer: roll, pitch, yaw
THRUST_N_PER_V = (0.03616, 0.117, -0.01215)  # F = a V^2 + b V + c of one motor, in the manufacturer's mixer
NOMINAL_V = 14.8  # a battery of four cells: the voltage at which thrust 1 is full thrust (our choice)
KV_RPM_PER_V = 1300.0
POLE_CORRECTION = 12 / 14  # the log takes 12 poles; 14 bring the hover from 177 Hz to the accelerometer's 148-154 Hz

# Limits of the checks, our choice: they are wide, for they tell units, signs and orders apart, not flights.
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


@dataclass(frozen=True, slots=True, eq=False)
class _Recording:
    """The three matrices with a row for each sample, (n, 56), (n, 37) and (n, 21); values that cannot be are NaN."""

    qdrone: FloatArray
    commander: FloatArray
    stabilizer: FloatArray

    def on_board(self, *rows: int) -> FloatArray:
        """Rows of QDrone_data by number, (n, k)."""
        return self.qdrone[:, [row - 1 for row in rows]]

    def commanded(self, *rows: int) -> FloatArray:
        """Rows of commander_data by number, (n, k)."""
        return self.commander[:, [row - 1 for row in rows]]

    def stabilized(self, *rows: int) -> FloatArray:
        """Rows of stabilizer_data by number, (n, k)."""
        return self.stabilizer[:, [row - 1 for row in rows]]

    @property
    def t_ns(self) -> IntArray:
        """(n,) time since the recording began."""
        return np.rint(self.qdrone[:, 0] * NS_PER_S).astype(np.int64)

    @property
    def flying(self) -> BoolArray:
        """(n,) the commander was in flight: not on the ground, taking off or landing."""
        return np.asarray(self.commander[:, 1] == FLIGHT_STATE, dtype=np.bool_)

    @property
    def raw_rate(self) -> FloatArray:
        """(n, 3) gyro of the first IMU, unfiltered [rad/s]."""
        return self.on_board(27, 28, 29) * FRD

    @property
    def filtered_rate(self) -> FloatArray:
        """(n, 3) the same behind the flight software's low-pass, 120 rad/s of second order [rad/s]."""
        return self.on_board(5, 6, 7) * FRD

    @property
    def imu_attitude(self) -> FloatArray:
        """(n, 3) roll, pitch and yaw that the first IMU estimates [rad]; its yaw drifts."""
        return self.on_board(2, 3, 4) * FRD

    def rate_setpoint(self) -> FloatArray:
        """(n, 3) commanded body rates, which are not recorded, from what the manufacturer's cascade does [rad/s].

        Roll, pitch: 12 (reference - angle) - 0.1 rate; yaw: 2 reference; each within 10 pi/3.
        """
        angle = 0.5 * (self.on_board(2, 3, 4) + self.on_board(11, 12, 13))
        rate = 0.5 * (self.on_board(5, 6, 7) + self.on_board(14, 15, 16))
        angle[:, 2] = 0.0
        command = ANGLE_GAIN_PER_S * (self.stabilized(9, 10, 11) - angle) - RATE_GAIN * rate
        return np.clip(command, -MAX_RATE_RAD_S, MAX_RATE_RAD_S) * FRD

    def values(self) -> dict[Signal, FloatArray]:
        """Every signal in SI units and FRD, but for the rotors' speed."""
        mean = 0.5 * (self.on_board(2, 3) + self.on_board(11, 12))  # of both IMUs, as the controller had it
        return {
            Signal.ATTITUDE_SETPOINT: np.column_stack((self.stabilized(9, 10), self.commanded(29))) * FRD,
            Signal.RATE_SETPOINT: self.rate_setpoint(),
            Signal.THRUST_SETPOINT: np.clip(self.stabilized(8) / full_thrust_n(), 0.0, 1.0),
            Signal.TORQUE_COMMAND: self.stabilized(19, 20, 21) / MAX_TORQUE_NM * FRD,  # behind its saturation
            Signal.BODY_RATE: self.raw_rate,
            Signal.SPECIFIC_FORCE: self.on_board(30, 31, 32) * FRD,  # of the first IMU
            Signal.ATTITUDE: np.column_stack((mean, self.commanded(25))) * FRD,  # yaw: the motion capture's
            Signal.ACTUATOR: self.on_board(20, 21, 22, 23),  # share of the battery's voltage
            Signal.HEIGHT: self.commanded(24),  # by the motion capture
            Signal.VOLTAGE: self.on_board(24),
            Signal.ARMED: self.flying.astype(np.float64),
        }

    def rotor_speed(self) -> FloatArray:
        """(n, 4) speeds that the ESCs measured [rad/s]; NaN until a rotor's first telemetry.

        The recorded number is speed / (1300 rpm/V x voltage) with 12 poles.
        """
        return self.on_board(54, 52, 50, 48) * self.on_board(24) * (KV_RPM_PER_V * POLE_CORRECTION * RPM)


def full_thrust_n(volt: float = NOMINAL_V) -> float:
    """Thrust of all four motors at full duty [N].

    >>> round(full_thrust_n(), 2)
    38.56
    """
    a, b, c = THRUST_N_PER_V
    return 4 * (a * volt**2 + b * volt + c)


def read_dronepropa(path: Path, profile: str | None = None) -> Log:
    """Read a recording. profile: "dronepropa" for the raw gyro (None as well), "dronepropa-filtered" for the filtered.

    All signals have a sample each ms; values that are no number are NaN. Rotors are numbered as in the thesis.
    Raises InputError for a file that is unreadable, damaged, of another content, or that contradicts the table of its
    rows; a file that is only cut off is read as far as it reaches, with a note. UsageError for another profile.
    """
    if profile not in (None, PROFILE, FILTERED_PROFILE):
        raise UsageError(f"a DronePropA recording has the profiles {PROFILE} and {FILTERED_PROFILE}, not {profile}")
    data = read_bytes(path)
    try:
        matrices, notes = read_matrices(data, ROWS)
        recording, skewed = _recording(matrices)
        values = recording.values()
        notes += (*skewed, *_check(recording, values))
    except InputError as error:
        raise InputError(f"{path}: not a usable DronePropA recording: {error}") from error
    if profile == FILTERED_PROFILE:
        values[Signal.BODY_RATE] = recording.filtered_rate
    if _speeds_are_certain(recording):
        values[Signal.ROTOR_SPEED] = recording.rotor_speed()
    series = tuple(recorded(signal, recording.t_ns, found) for signal, found in values.items())
    return Log(path.name, sha256_of(data), profile or PROFILE, Telemetry(series), notes=notes)


def _recording(matrices: Mapping[str, FloatArray]) -> tuple[_Recording, list[str]]:
    """The matrices as far as all three reach, and what is wrong with their times.

    Raises InputError if the time makes no sense. The matrices are records of one another sample by sample (the copies
    in them are equal), so their rows are paired by number, and time is that of QDrone_data.
    """
    count = min(len(matrix) for matrix in matrices.values())
    if count < MIN_SAMPLES:
        raise InputError(f"only {count} samples: download it again")
    tables = [_finite(matrices[name][:count]) for name in ROWS]
    recording = _Recording(*tables)
    t_s = recording.qdrone[:, 0]
    if not (np.isfinite(t_s).all() and (np.abs(t_s) < MAX_TIME_S).all() and (np.diff(recording.t_ns) > 0).all()):
        raise InputError("its time does not increase from sample to sample")
    skews_s = {
        name: float(np.nan_to_num(np.abs(table[:, 0] - t_s)).max()) for name, table in zip(ROWS, tables, strict=True)
    }
    told = [name for name, skew_s in skews_s.items() if skew_s > SKEW_S]
    return recording, [
        f"{name} has times that differ from QDrone_data's by up to {skews_s[name]:.3g} s" for name in told
    ]


def _finite(values: FloatArray) -> FloatArray:
    """With NaN for what is infinite (the ESCs' rows are divided by zero until their first telemetry) or damaged."""
    return np.where(np.abs(values) < MAX_VALUE, values, np.nan)


def _check(recording: _Recording, values: Mapping[Signal, FloatArray]) -> tuple[str, ...]:
    """What could not be confirmed of the flight, one sentence each. Raises InputError if it contradicts the table."""
    dt_s = float(np.median(np.diff(recording.qdrone[:, 0])))
    flying, force = recording.flying, values[Signal.SPECIFIC_FORCE]
    if int(flying.sum()) * dt_s < MIN_FLIGHT_S:
        _check_gravity(force)
        return (f"less than {MIN_FLIGHT_S:g} s in flight: signs and motor order could not be checked",)
    _check_gravity(force[flying])
    notes = [
        *_check_gyros(recording, flying, dt_s),
        *_check_order(values[Signal.ACTUATOR][flying], values[Signal.TORQUE_COMMAND][flying]),
        *_check_line(force[flying], dt_s),
    ]
    _check_references(recording, values, flying, dt_s)
    if not _speeds_are_certain(recording):
        notes.append("rows 20 to 23 are not rows 53, 51, 49 and 47: the speeds of the ESCs were left out")
    return tuple(notes)


def _speeds_are_certain(recording: _Recording) -> bool:
    """Whether the copies of the motor commands stand beside the ESCs' rows in the order of the table."""
    flying = recording.flying
    commands, copies = recording.on_board(20, 21, 22, 23)[flying], recording.on_board(53, 51, 49, 47)[flying]
    return all(_fit(commands[:, i], copies[:, i])[1] > SAME for i in range(4))


def _check_gravity(force: FloatArray) -> None:
    """At rest and in mean flight the specific force is 9.8 m/s^2, upwards: -9.8 along z of FRD."""
    known = force[np.isfinite(force).all(axis=1)]
    mean = known.mean(axis=0) if len(known) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    if not GRAVITY_M_S2[0] <= size <= GRAVITY_M_S2[1]:
        raise InputError(f"the mean specific force is {size:.2f} m/s^2, not 9.8 (rows 30 to 32): {_RULE}")
    if mean[2] > -CLEAR * size:
        raise InputError(f"gravity is not along the vertical axis (row 32 has {-mean[2]:.2f} m/s^2, not +9.8): {_RULE}")


def _check_gyros(recording: _Recording, flying: BoolArray, dt_s: float) -> list[str]:
    """The attitude estimates change by what the gyro integrates to, axis by axis.

    dphi   = p + tan(theta) (q sin(phi) + r cos(phi))
    dtheta = q cos(phi) - r sin(phi)
    dpsi   = (q sin(phi) + r cos(phi)) / cos(theta)
    """
    angle = recording.imu_attitude
    changes = _change(angle, flying, dt_s)
    notes: list[str] = []
    for name, rate in (("raw", recording.raw_rate), ("filtered", recording.filtered_rate)):
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


def _over_windows(values: FloatArray, flying: BoolArray, dt_s: float) -> FloatArray:
    """What values (n, k) change by over each window that begins and ends in flight, (k, windows)."""
    width = max(1, round(WINDOW_S / dt_s))
    first = np.arange(0, len(flying) - width, width)
    first = first[flying[first] & flying[first + width]]
    change: FloatArray = values[first + width] - values[first]
    return change.T


def _change(angle: FloatArray, flying: BoolArray, dt_s: float) -> FloatArray:
    """What angles (n, k) change by over each window in flight, (k, windows), within half a turn."""
    return (_over_windows(angle, flying, dt_s) + np.pi) % (2 * np.pi) - np.pi


def _integral(rate: FloatArray, flying: BoolArray, dt_s: float) -> FloatArray:
    """What rates (n, k) integrate to over each window in flight, (k, windows)."""
    total = np.concatenate((np.zeros((1, rate.shape[1])), np.cumsum(np.nan_to_num(rate), axis=0))) * dt_s
    return _over_windows(total, flying, dt_s)


def _check_references(
    recording: _Recording, values: Mapping[Signal, FloatArray], flying: BoolArray, dt_s: float
) -> None:
    """Roll and pitch follow their references, and the motion capture's yaw changes as the IMU's, which drifts."""
    angle, reference = values[Signal.ATTITUDE], values[Signal.ATTITUDE_SETPOINT]
    captured, estimated = (_change(yaw, flying, dt_s) for yaw in (angle[:, 2:], recording.imu_attitude[:, 2:]))
    pairs = (
        ("roll reference (row 9)", reference[flying, 0], angle[flying, 0]),
        ("pitch reference (row 10)", reference[flying, 1], angle[flying, 1]),
        ("motion capture's yaw (row 25)", captured[0], estimated[0]),
    )
    for name, reference_row, estimate in pairs:
        if _fit(reference_row, estimate)[1] < -CLEAR:
            raise InputError(f"the {name} runs against the IMU's estimate: {_RULE}")


def _check_order(outputs: FloatArray, torque: FloatArray) -> list[str]:
    """The motor commands mix into the torque commands of roll and pitch, which settles the order of all four."""
    mixed = outputs @ layout_named("qdrone2").unmixing.T
    notes = []
    for i, axis in enumerate(_AXES[:2]):
        _, correlation = _fit(torque[:, i], mixed[:, i])
        if correlation == 0.0:
            notes.append(f"no {axis} torque command to check the order of the motors with")
        elif correlation < CLEAR:
            raise InputError(f"rows 20 to 23 do not mix into the {axis} torque: the motors are in another order")
    return notes


def _check_line(force: FloatArray, dt_s: float) -> list[str]:
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


# State 5 begins at the end of the take-off; 3 s into it the flights are some 14 s old, which is what the recordings'
# own plots advise to leave out, and its last second leads into the landing. Both spans are our choice.
KIND = LogKind(
    "DronePropA",
    is_mat,
    lambda path, vehicle, profile: read_dronepropa(path, profile),
    PROFILE,
    GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=3.0, trim_end_s=1.0),
    airframe_name="qdrone2-recorded",
    variants=(FILTERED_PROFILE,),
)
