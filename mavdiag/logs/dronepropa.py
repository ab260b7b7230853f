"""Recordings of the QDrone 2 in DronePropA: MATLAB files with QDrone_data, commander_data and stabilizer_data.

DronePropA (Mendeley Data, 10.17632/ftdyxrr3c5.1, CC BY 4.0) holds 130 flights of three QDrone 2, healthy and with the
thesis's nine faults, at 1 kHz. `dronepropa_rows` says what each row is, `dronepropa_checks` asks the file whether that
is so. No raw flight was at hand when this was written: it is tested on made files of the same layout.

Which gyro. BODY_RATE is the unfiltered gyro of the first IMU (rows 27 to 29). The thesis's residual fits it: from the
published noise of the healthy flights a one-step prediction leaves 0.8 to 1.6 mrad/s behind a Savitzky-Golay window of
101 samples, as Fig 5.7 shows, and 20 times less on the filtered gyro (rows 5 to 7). That one is read on request, under
a profile of its own, since a baseline of one says nothing of the other.

Flight. ARMED is true in the commander's state 5 only, so that idling, take-off and landing are never judged. On the
ground the motors turn for seven seconds with a limit cycle of the yaw torque at 24 Hz.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mavdiag.errors import InputError, UsageError
from mavdiag.logs.dronepropa_checks import check, speeds_are_certain
from mavdiag.logs.dronepropa_rows import ROWS, Recording
from mavdiag.logs.log import LogKind, read_bytes, sha256_of
from mavdiag.logs.mat5 import Matrix, is_mat, read_matrices
from mavdiag.logs.records import recorded
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import FloatArray, Log, Series, Signal, Telemetry

__all__ = ["FILTERED_PROFILE", "KIND", "PROFILE", "read_dronepropa"]

PROFILE = "dronepropa"
FILTERED_PROFILE = "dronepropa-filtered"
MAX_TIME_S = 1e6  # 11 days: anything later is damage
MAX_VALUE = 1e9  # no row comes near it: more is damage (our choice)
MIN_SAMPLES = 20
SKEW_S = 0.002  # times of the matrices that differ by more are worth a note (our choice)


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
        matrices = read_matrices(data, ROWS)
        recording, notes = _recording(matrices)
        notes += check(recording)
        telemetry = Telemetry(_series(recording, filtered=profile == FILTERED_PROFILE))
    except InputError as error:
        raise InputError(f"{path}: not a usable DronePropA recording: {error}") from error
    return Log(path.name, sha256_of(data), profile or PROFILE, telemetry, notes=notes)


def _recording(matrices: Mapping[str, Matrix]) -> tuple[Recording, tuple[str, ...]]:
    """The matrices as far as all three reach, and what is wrong with them.

    Raises InputError if the time makes no sense. The matrices are records of one another sample by sample (the copies
    in them are equal), so their rows are paired by number, and time is that of QDrone_data.
    """
    count = min(len(one.values) for one in matrices.values())
    if count < MIN_SAMPLES:
        raise InputError(f"only {count} samples: download it again")
    tables = [_finite(matrices[name].values[:count]) for name in ROWS]
    recording = Recording(*tables)
    t_s = recording.qdrone[:, 0]
    if not (np.isfinite(t_s).all() and (np.abs(t_s) < MAX_TIME_S).all() and (np.diff(recording.t_ns) > 0).all()):
        raise InputError("its time does not increase from sample to sample")
    notes = [one.note for one in matrices.values() if one.note]
    for name, table in zip(ROWS, tables, strict=True):
        skew_s = float(np.nan_to_num(np.abs(table[:, 0] - t_s), nan=0.0).max())
        if skew_s > SKEW_S:
            notes.append(f"{name} has times that differ from QDrone_data's by up to {skew_s:.3g} s")
    return recording, tuple(notes)


def _finite(values: FloatArray) -> FloatArray:
    """With NaN for what is infinite (the ESCs' rows are divided by zero until their first telemetry) or damaged."""
    return np.where(np.abs(values) < MAX_VALUE, values, np.nan)


def _series(recording: Recording, *, filtered: bool) -> tuple[Series, ...]:
    """Every signal, in SI units and FRD."""
    values: dict[Signal, FloatArray] = {
        Signal.ATTITUDE_SETPOINT: recording.attitude_setpoint(),
        Signal.RATE_SETPOINT: recording.rate_setpoint(),
        Signal.THRUST_SETPOINT: recording.thrust(),
        Signal.TORQUE_COMMAND: recording.torque(),
        Signal.BODY_RATE: recording.filtered_rate() if filtered else recording.raw_rate(),
        Signal.SPECIFIC_FORCE: recording.force(),
        Signal.ATTITUDE: recording.attitude(),
        Signal.ACTUATOR: recording.outputs(),
        Signal.HEIGHT: recording.height(),
        Signal.VOLTAGE: recording.voltage(),
        Signal.ARMED: recording.flying.astype(np.float64),
    }
    if speeds_are_certain(recording):
        values[Signal.ROTOR_SPEED] = recording.rotor_speed()
    return tuple(recorded(signal, recording.t_ns, found) for signal, found in values.items())


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
