"""Link profiles: how a kind of vehicle sends the same things, as one table.

A baseline is bound to a profile, because its filter, its rate and its stamps shape the identified model. A new
autopilot is one row of `_ROWS`, and its number in `mavdiag.link.messages.Autopilot`.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Self

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.link.codec import Frame, Frames, layout_of, message_name
from mavdiag.link.messages import Autopilot, MavType, MessageId
from mavdiag.link.scale import CONTRARY, scale_of
from mavdiag.rows.gate import GateSpec
from mavdiag.units import DEG, G

MILLI = 1e-3
MILLI_G, IIM_42652 = (700.0, 1431.0), (1431.0, 2900.0)  # counts of 1 g: about 1000, about 2048; parted at their mean
# Our choices: armed, more than idle thrust, and five seconds for the climb. Live, an alert must not wait for an end.
LIVE_GATE = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=5.0)
ARDUPILOT_PERIOD_US = 2500  # Copter's loop period at its usual 400 Hz; RAW_IMU cannot be faster
WEIGHED = 16_384  # RAW_IMUs that tell a log's unit and rate: 16 s at 1 kHz (our choice)
SELDOM = 4  # an IMU message that comes so many times more seldom than another is not preferred to it (our choice)


#: Messages with a gyro and an accelerometer, in order of preference after a profile's own, and what one count is in
#: m/s^2 and in rad/s; RAW_IMU has no unit: the profile says.
IMU_MESSAGES: Mapping[MessageId, tuple[float, float] | None] = {
    MessageId.HIGHRES_IMU: (1.0, 1.0),
    **dict.fromkeys((MessageId.SCALED_IMU, MessageId.SCALED_IMU2, MessageId.SCALED_IMU3), (MILLI * G, MILLI)),
    MessageId.RAW_IMU: None,
}
LAST_RESORT = MessageId.ATTITUDE  # body rates without accelerometer; read only where none of `IMU_MESSAGES` comes

_BEAT = ("type", "autopilot")
_HEARTBEAT = layout_of(MessageId.HEARTBEAT).record_dtype(*((name, 1) for name in _BEAT))
_RAW_IMU = layout_of(MessageId.RAW_IMU).record_dtype(("time_usec", 1), ("xacc", 3))


class Evidence:
    """What the frames of one vehicle's autopilot show of its profile, gathered piece by piece, in order of arrival.

    counts: of each message. beats: of each MAV_TYPE and MAV_AUTOPILOT in its heartbeats, not a station's or computer's.
    parameters: its PARAM_VALUEs.
    """

    def __init__(self) -> None:
        self.counts, self.beats = Counter[int](), Counter[tuple[int, int]]()
        self.parameters, self._raw = list[Frame](), np.empty(0, _RAW_IMU)

    def take(self, frames: Frames) -> Self:
        """Take in the next frames; returns itself."""
        self.counts += frames.counts()
        self.parameters += frames.of(MessageId.PARAM_VALUE)
        record = frames.of(MessageId.HEARTBEAT).records(_HEARTBEAT)
        for kind, autopilot in zip(*(record[name].tolist() for name in _BEAT), strict=True):
            if kind not in (MavType.GCS, MavType.ONBOARD_CONTROLLER) and autopilot != Autopilot.INVALID:
                self.beats[kind, autopilot] += 1
        if len(self._raw) < WEIGHED:
            raw = frames.of(MessageId.RAW_IMU).where(slice(WEIGHED - len(self._raw)))
            self._raw = np.concatenate((self._raw, raw.records(_RAW_IMU)))
        return self

    @property
    def mav_type(self) -> int | None:
        """MAV_TYPE by most of its heartbeats; None without any."""
        kinds = Counter[int]()
        for (kind, _), count in self.beats.items():
            kinds[kind] += count
        return kinds.most_common(1)[0][0] if kinds else None

    @property
    def autopilots(self) -> frozenset[int]:
        """What its heartbeats name it, MAV_AUTOPILOT."""
        return frozenset(autopilot for _, autopilot in self.beats)

    @property
    def weight(self) -> float:
        """Median size of RAW_IMU's acceleration, in counts, for a vehicle feels its own weight; NaN without it."""
        sizes = np.linalg.norm(self._raw["xacc"].astype(np.float64), axis=1)
        return float(np.median(sizes)) if len(sizes) else float("nan")

    @property
    def period_us(self) -> float:
        """Median period of RAW_IMU, whose frames may come twice; NaN without it."""
        steps = np.diff(self._raw["time_usec"].astype(np.int64))
        return float(np.median(steps[steps > 0])) if (steps > 0).any() else float("nan")

    def weighs(self, span: tuple[float, float]) -> bool:
        """Whether one g is within this span of counts."""
        return span[0] <= self.weight < span[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """How one kind of vehicle sends what the diagnosis needs."""

    name: str  # how users and baselines call it
    autopilot: int  # MAV_AUTOPILOT of its heartbeat
    recognise: Callable[[Evidence], bool]  # whether the frames of a vehicle are of this profile
    imu: MessageId
    accel_unit: float  # one count of the IMU message [m/s^2]
    gyro_unit: float  # one count of it [rad/s]
    rate_hz: float  # nominal rate of the pair of set-point and IMU message
    imu_corner_hz: float | None  # of the low-pass filter in the IMU stream by default, None if vibration passes
    vibration: bool  # whether its VIBRATION message carries acceleration per axis
    actuator: MessageId
    actuator_span: tuple[float, float]  # values for 0 and for full output; ACTUATOR_OUTPUT_STATUS is told by its own
    rotor_speed: MessageId
    setpoint: MessageId = MessageId.ATTITUDE_TARGET
    gate: GateSpec = LIVE_GATE  # what counts as flying; the same live and in a .tlog
    imu_corner_parameter: str = ""  # the autopilot's parameter of that corner [Hz], 0 for none; empty without

    @property
    def messages(self) -> frozenset[int]:
        """The messages of which another profile may use others."""
        chosen = {self.setpoint, self.imu, self.actuator, self.rotor_speed}
        return frozenset(chosen | {MessageId.VIBRATION} if self.vibration else chosen)

    def corner_hz(self, parameters: Mapping[str, float]) -> float | None:
        """Corner of the low-pass filter in the IMU stream of a vehicle with these parameters, None for none [Hz]."""
        told = parameters.get(self.imu_corner_parameter)
        return self.imu_corner_hz if told is None else told if told > 0.0 else None


def _is_ardupilot(seen: Evidence) -> bool:
    """It says so; what sends RAW_IMU faster than its loop allows is another one under its name."""
    raw = seen.counts.get(MessageId.RAW_IMU, 0) > 0
    sound = not raw or (seen.weighs(MILLI_G) and not seen.period_us < ARDUPILOT_PERIOD_US)
    return sound and Autopilot.ARDUPILOTMEGA in seen.autopilots


def _is_px4(seen: Evidence) -> bool:
    named = Autopilot.PX4 in seen.autopilots or seen.counts.get(MessageId.HIGHRES_IMU, 0) > 0
    return named and not seen.counts.get(MessageId.RAW_IMU, 0)


# The QDrone 2 behind its bridge: milli-g and mrad/s as ArduPilot fills RAW_IMU, sampled at 1 kHz (T 5.3).
_QDRONE2 = Profile(
    name="qdrone2",
    autopilot=Autopilot.GENERIC,
    recognise=lambda seen: seen.weighs(MILLI_G),
    imu=MessageId.RAW_IMU,
    accel_unit=MILLI * G,
    gyro_unit=MILLI,
    rate_hz=1000.0,
    imu_corner_hz=None,
    vibration=False,
    actuator=MessageId.SERVO_OUTPUT_RAW,
    actuator_span=(1000.0, 2000.0),
    rotor_speed=MessageId.ESC_STATUS,
)
_ROWS = (
    # RAW_IMU as its definition has it, without unit: the counts of the IIM-42652 at its full scale of 16 g and
    # 2000 deg/s (data sheet: 2048 LSB/g and 16.4 LSB/(deg/s)).
    replace(
        _QDRONE2, name="spec", recognise=lambda seen: seen.weighs(IIM_42652), accel_unit=G / 2048, gyro_unit=DEG / 16.4
    ),
    # ArduPilot Copter: RAW_IMU is low-passed (INS_GYRO_FILTER, INS_ACCEL_FILTER), stamped when sent; 50-200 Hz exact.
    replace(
        _QDRONE2,
        name="ardupilot",
        autopilot=Autopilot.ARDUPILOTMEGA,
        recognise=_is_ardupilot,
        rate_hz=100.0,
        imu_corner_hz=20.0,
        vibration=True,
        rotor_speed=MessageId.ESC_TELEMETRY_1_TO_4,
        imu_corner_parameter="INS_GYRO_FILTER",
    ),
    # PX4: no RAW_IMU; HIGHRES_IMU is in SI and comes from the sensors before the controller's filter; its VIBRATION
    # mixes gyro and accelerometer metrics. Asked for 200 Hz it sends 160 to 170.
    replace(
        _QDRONE2,
        name="px4",
        autopilot=Autopilot.PX4,
        recognise=_is_px4,
        imu=MessageId.HIGHRES_IMU,
        accel_unit=1.0,
        gyro_unit=1.0,
        rate_hz=160.0,
        actuator=MessageId.ACTUATOR_OUTPUT_STATUS,
        actuator_span=(0.0, 1.0),
    ),
    _QDRONE2,
)

PROFILES: Mapping[str, Profile] = {profile.name: profile for profile in _ROWS}


def profile_named(name: str) -> Profile:
    """The profile of that name. Raises UsageError, listing the names, if there is none."""
    if name not in PROFILES:
        raise UsageError(f"no link profile {name}; there are {', '.join(PROFILES)}")
    return PROFILES[name]


def detect_profile(seen: Evidence, profiles: Iterable[Profile] = _ROWS) -> tuple[Profile | None, str]:
    """The first of the profiles that one vehicle's frames fit, never a guess; or None and why, one sentence."""
    found = next((profile for profile in profiles if profile.recognise(seen)), None)
    if found is not None:
        return found, ""
    imu = [message_name(message) for message in IMU_MESSAGES if seen.counts.get(message)]
    if isfinite(seen.weight):
        why = f"RAW_IMU counts {seen.weight:.0f} at rest, {scale_of(seen.weight)}; only 1000 and 2048 are read"
    else:
        why = f"it sends {', '.join(imu) or 'no IMU message'} and its autopilot is not known"
    return None, f"its link profile is not clear: {why}"


def scale_doubt(profile: Profile, gravity_g: float) -> str:
    """What speaks against the profile's accelerometer scale, in a few words; empty if nothing does.

    gravity_g: what the vehicle feels, by that scale, while it stands or hovers.

    >>> scale_doubt(PROFILES["qdrone2"], 2.05), scale_doubt(PROFILES["qdrone2"], 1.1)
    ('2.0 g: --profile spec', '')
    """
    if 1.0 / CONTRARY < gravity_g < CONTRARY:
        return ""
    counts = gravity_g * G / profile.accel_unit
    raw = (one for one in _ROWS if one.imu == profile.imu == MessageId.RAW_IMU)
    fits = next((one.name for one in raw if 1.0 / CONTRARY < counts * one.accel_unit / G < CONTRARY), "")
    return f"{gravity_g:.1f} g" + (f": --profile {fits}" if fits else "")


def with_imu(profile: Profile, counts: Mapping[int, int], least: int = 1) -> Profile:
    """The profile with the one IMU message that a vehicle is best judged by; BODY_RATE never mixes two.

    It is the profile's own, or else the first of `IMU_MESSAGES`, that comes at least `least` times and no fewer than a
    quarter as often as the most frequent one. Where none does, the profile's own stays. counts: frames of each message.
    """
    choice = (profile.imu, *(message for message, units in IMU_MESSAGES.items() if units and message != profile.imu))
    enough = max(least, max(counts.get(message, 0) for message in choice) / SELDOM)
    chosen = next((message for message in choice if counts.get(message, 0) >= enough), profile.imu)
    units = IMU_MESSAGES[chosen]
    if chosen == profile.imu or units is None:
        return profile
    return replace(profile, imu=chosen, accel_unit=units[0], gyro_unit=units[1])
