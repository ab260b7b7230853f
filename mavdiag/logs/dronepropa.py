"""Recordings of the QDrone 2 in DronePropA: MATLAB files with QDrone_data, commander_data and stabilizer_data.

docs/droneprop.md has what the rows, from 1, are taken for, and what each file is asked. The published table (Data in
Brief, 10.1016/j.dib.2025.111589) names about half of them; the others follow from the manufacturer's public hover-test
model (QD2_DroneStack_PID_2021a) and published statistics. The manufacturer's frame is x forward, y left, z up.
"""

import hashlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from mavdiag.airframe.layout import layout_named
from mavdiag.errors import InputError, UsageError
from mavdiag.logs.log import LogKind, read_bytes, recorded, usable_as
from mavdiag.logs.matlab import is_mat, read_matrices
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
NOMINAL_V = 14.8  # a battery of four cells: the voltage at which thrust 1 is full thrust (our choice)
FULL_THRUST_N = 4 * (0.03616 * NOMINAL_V**2 + 0.117 * NOMINAL_V - 0.01215)  # four motors of the manufacturer's mixer
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
_AXES = ("roll", "pitch", "yaw")
_RULE = "the rows are not those of DronePropA"


class _Recording:
    """The three matrices as far as all reach, with a row for each sample, from x forward, y left, z up to FRD.

    q, c, s: by the numbers of rows, (n, k) of QDrone_data, commander_data and stabilizer_data; NaN for what cannot be.
    rates: (n, 3) gyro of the first IMU [rad/s]: raw, and behind the flight software's low-pass, 120 rad/s, order 2.
    speeds_are_certain: whether copies of the motor commands stand beside the ESCs' rows in the order of the table.
    """

    def __init__(self, matrices: Mapping[str, FloatArray]) -> None:
        count = min(map(len, matrices.values()))
        if count < MIN_SAMPLES:
            raise InputError(f"only {count} samples: download it again")
        # NaN stands for what is infinite (ESCs are divided by zero until their first telemetry) or damaged.
        tables = [np.where(np.abs(matrices[name][:count]) < MAX_VALUE, matrices[name][:count], np.nan) for name in ROWS]
        t_s = tables[0][:, 0]
        if not ((np.abs(t_s) < MAX_TIME_S).all() and (np.diff(np.rint(t_s * NS_PER_S)) > 0).all()):
            raise InputError("its time does not increase from sample to sample")
        skews_s = [float(np.nan_to_num(np.abs(table[:, 0] - t_s)).max()) for table in tables]
        told = ((name, skew_s) for name, skew_s in zip(ROWS, skews_s, strict=True) if skew_s > SKEW_S)
        self.notes = [f"{one} has times that differ from QDrone_data's by up to {skew_s:.3g} s" for one, skew_s in told]
        self.q, self.c, self.s = (partial(_rows, table) for table in tables)
        self.t_ns: IntArray = np.rint(self.q(1)[:, 0] * NS_PER_S).astype(np.int64)
        self.dt_s = float(np.median(np.diff(self.q(1)[:, 0])))
        self.flying: BoolArray = self.c(2)[:, 0] == FLIGHT_STATE
        self.rates = {"raw": self.q(27, 28, 29) * FRD, "filtered": self.q(5, 6, 7) * FRD}
        self.imu_attitude = self.q(2, 3, 4) * FRD  # as the first IMU estimates it; its yaw drifts
        commands, copies = (rows[self.flying].T for rows in (self.q(20, 21, 22, 23), self.q(53, 51, 49, 47)))
        self.speeds_are_certain = all(_fit(x, y)[1] > SAME for x, y in zip(commands, copies, strict=True))

    def values(self) -> dict[Signal, FloatArray]:
        """Every signal in SI units. The rotors' speed only where it is certain; NaN until its first telemetry.

        Commanded rates are not recorded; the manufacturer's cascade makes them of the means of both IMUs: roll, pitch:
        12 (reference - angle) - 0.1 rate; yaw: 2 reference; each within 10 pi/3. The recorded number of a speed is
        speed / (1300 rpm/V x voltage) with 12 poles.
        """
        q, c, s = self.q, self.c, self.s
        mean, rate = 0.5 * (q(2, 3) + q(11, 12)), 0.5 * (q(5, 6, 7) + q(14, 15, 16))
        error = s(9, 10, 11) - np.column_stack((mean, np.zeros(len(mean))))
        rate_command = np.clip(ANGLE_GAIN_PER_S * error - RATE_GAIN * rate, -MAX_RATE_RAD_S, MAX_RATE_RAD_S)
        found = {
            Signal.ATTITUDE_SETPOINT: np.column_stack((s(9, 10), c(29))) * FRD,
            Signal.RATE_SETPOINT: rate_command * FRD,
            Signal.THRUST_SETPOINT: np.clip(s(8) / FULL_THRUST_N, 0.0, 1.0),
            Signal.TORQUE_COMMAND: s(19, 20, 21) / MAX_TORQUE_NM * FRD,  # behind its saturation
            Signal.BODY_RATE: self.rates["raw"],
            Signal.SPECIFIC_FORCE: q(30, 31, 32) * FRD,  # of the first IMU
            Signal.ATTITUDE: np.column_stack((mean, c(25))) * FRD,  # yaw: the motion capture's
            Signal.ACTUATOR: q(20, 21, 22, 23),  # share of the battery's voltage
            Signal.HEIGHT: c(24),  # by the motion capture
            Signal.VOLTAGE: q(24),
            Signal.ARMED: self.flying.astype(np.float64),
        }
        if self.speeds_are_certain:
            found[Signal.ROTOR_SPEED] = q(54, 52, 50, 48) * q(24) * (KV_RPM_PER_V * POLE_CORRECTION * RPM)
        return found

    def over_windows(self, values: FloatArray) -> FloatArray:
        """What values (n, k) change by over each window that begins and ends in flight, (k, windows)."""
        width = max(1, round(WINDOW_S / self.dt_s))
        first = np.arange(0, len(values) - width, width)
        first = first[self.flying[first] & self.flying[first + width]]
        return np.asarray(values[first + width] - values[first]).T

    def turns(self, angle: FloatArray) -> FloatArray:
        return (self.over_windows(angle) + np.pi) % (2 * np.pi) - np.pi


def _rows(matrix: FloatArray, *numbers: int) -> FloatArray:
    return matrix[:, [number - 1 for number in numbers]]


def read_dronepropa(path: Path, profile: str | None = None) -> Log:
    """Read a recording. profile: "dronepropa" for the raw gyro (None as well), "dronepropa-filtered" for the filtered.

    Raises InputError for a file that is unreadable, damaged, of another content, or that contradicts the table of its
    rows; a file that is only cut off is read as far as it reaches, with a note. UsageError for another profile.
    """
    if profile not in (None, PROFILE, FILTERED_PROFILE):
        raise UsageError(f"a DronePropA recording has the profiles {PROFILE} and {FILTERED_PROFILE}, not {profile}")
    data = read_bytes(path)
    with usable_as("DronePropA recording", path):
        matrices, notes = read_matrices(data, ROWS)
        recording = _Recording(matrices)
        values = recording.values()
        notes += (*recording.notes, *_check(recording, values))
    if profile == FILTERED_PROFILE:
        values[Signal.BODY_RATE] = recording.rates["filtered"]
    series = tuple(recorded(signal, recording.t_ns, found) for signal, found in values.items())
    return Log(path.name, hashlib.sha256(data).hexdigest(), profile or PROFILE, Telemetry(series), notes=notes)


def _check(recording: _Recording, values: Mapping[Signal, FloatArray]) -> tuple[str, ...]:
    """What could not be confirmed of the flight, one sentence each. Raises InputError if it contradicts the table."""
    flying, force = recording.flying, values[Signal.SPECIFIC_FORCE]
    short = int(flying.sum()) * recording.dt_s < MIN_FLIGHT_S
    _check_gravity(force if short else force[flying])
    if short:
        return (f"less than {MIN_FLIGHT_S:g} s in flight: signs and motor order could not be checked",)
    order = _check_order(values[Signal.ACTUATOR][flying], values[Signal.TORQUE_COMMAND][flying])
    notes = (*_check_gyros(recording), *order)
    _check_references(recording, values)
    unsure = "rows 20 to 23 are not rows 53, 51, 49 and 47: the speeds of the ESCs were left out"
    return notes if recording.speeds_are_certain else (*notes, unsure)


def _check_gravity(force: FloatArray) -> None:
    """At rest and in mean flight the specific force is 9.8 m/s^2, upwards: -9.8 along z of FRD."""
    known = force[np.isfinite(force).all(axis=1)]
    mean = known.mean(axis=0) if len(known) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    if not GRAVITY_M_S2[0] <= size <= GRAVITY_M_S2[1]:
        raise InputError(f"the mean specific force is {size:.2f} m/s^2, not 9.8 (rows 30 to 32): {_RULE}")
    if mean[2] > -CLEAR * size:
        raise InputError(f"gravity is not along the vertical axis (row 32 has {-mean[2]:.2f} m/s^2, not +9.8): {_RULE}")


def _check_gyros(recording: _Recording) -> list[str]:
    """The attitude estimates change by what the gyro integrates to, axis by axis.

    dphi   = p + tan(theta) (q sin(phi) + r cos(phi))
    dtheta = q cos(phi) - r sin(phi)
    dpsi   = (q sin(phi) + r cos(phi)) / cos(theta)
    """
    (phi, theta, _), changes = recording.imu_attitude.T, recording.turns(recording.imu_attitude)
    notes: list[str] = []
    for name, (p, q, r) in ((name, rate.T) for name, rate in recording.rates.items()):
        turn = q * np.sin(phi) + r * np.cos(phi)
        euler = np.column_stack((p + np.tan(theta) * turn, q * np.cos(phi) - r * np.sin(phi), turn / np.cos(theta)))
        total = np.cumsum(np.nan_to_num(euler), axis=0) * recording.dt_s
        integrals = recording.over_windows(np.concatenate((np.zeros((1, 3)), total[:-1])))
        for axis, change, integral in zip(_AXES, changes, integrals, strict=True):
            slope, correlation = _fit(integral, change)
            if abs(correlation) < CLEAR:
                notes.append(f"too little {axis} motion to check the sign of the {name} {axis} gyro")
            elif correlation < 0 or (correlation > STRAIGHT and not SLOPE[0] <= slope <= SLOPE[1]):
                raise InputError(f"the {name} {axis} gyro is not the {axis} estimate's slope (x {slope:.3g}): {_RULE}")
            elif correlation <= STRAIGHT:
                notes.append(f"too little {axis} motion to check the scale of the {name} {axis} gyro")
    return notes


def _check_references(recording: _Recording, values: Mapping[Signal, FloatArray]) -> None:
    """Roll and pitch follow their references, and the motion capture's yaw changes as the IMU's, which drifts."""
    angle, reference, flying = values[Signal.ATTITUDE], values[Signal.ATTITUDE_SETPOINT], recording.flying
    captured, estimated = (recording.turns(yaw[:, 2:])[0] for yaw in (angle, recording.imu_attitude))
    for name, told, estimate in (
        ("roll reference (row 9)", reference[flying, 0], angle[flying, 0]),
        ("pitch reference (row 10)", reference[flying, 1], angle[flying, 1]),
        ("motion capture's yaw (row 25)", captured, estimated),
    ):
        if _fit(told, estimate)[1] < -CLEAR:
            raise InputError(f"the {name} runs against the IMU's estimate: {_RULE}")


def _check_order(outputs: FloatArray, torque: FloatArray) -> list[str]:
    """The motor commands mix into the torque commands of roll and pitch, which settles the order of all four."""
    mixed, notes = outputs @ layout_named("qdrone2").unmixing.T, []
    for i, axis in enumerate(_AXES[:2]):
        _, correlation = _fit(torque[:, i], mixed[:, i])
        if correlation == 0.0:
            notes.append(f"no {axis} torque command to check the order of the motors with")
        elif correlation < CLEAR:
            raise InputError(f"rows 20 to 23 do not mix into the {axis} torque: the motors are in another order")
    return notes


def _fit(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope of y on x and their correlation over what is finite, both (n,); zeros if one of them stands still."""
    known = np.isfinite(x) & np.isfinite(y)
    if int(known.sum()) < 3:
        return 0.0, 0.0
    (xx, xy), (_, yy) = np.cov(x[known], y[known]).tolist()
    if not (xx > 0 and yy > 0 and np.isfinite(xx * yy)):
        return 0.0, 0.0
    return xy / xx, xy / float(np.sqrt(xx * yy))


# 3 s into state 5 the flights are some 14 s old, which is what the recordings' own plots advise to leave out, and its
# last second leads into the landing. Both spans are our choice.
KIND = LogKind(
    "DronePropA",
    is_mat,
    lambda path, vehicle, profile: read_dronepropa(path, profile),
    (PROFILE, FILTERED_PROFILE),
    GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=3.0, trim_end_s=1.0),
    airframe_name="qdrone2-recorded",
)
