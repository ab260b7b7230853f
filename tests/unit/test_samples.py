"""Frames become SI samples: scales to the quantum, masks, clocks, and no dependence on how the frames are cut."""

from itertools import count
from math import pi, radians

import numpy as np
import pytest

from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.conversion import euler_angles
from mavdiag.link.messages import MavType, MessageId, ModeFlag, TargetMask
from mavdiag.link.profiles import PROFILES, Profile, detect_profile, profile_named
from mavdiag.link.samples import SampleDecoder, SampleState, by_vehicle, joined
from mavdiag.telemetry import FloatArray, Signal, Telemetry

G = 9.80665
LEVEL = (1.0, 0.0, 0.0, 0.0)
ARMED = (MavType.QUADROTOR, 3, ModeFlag.SAFETY_ARMED, 0, 4, 3)


class Vehicle:
    """Encodes messages and receives them, a millisecond of host time apart."""

    def __init__(self, sysid: int = 1, compid: int = 1) -> None:
        self._encoder, self._decoder, self._host = Encoder(sysid, compid), Decoder(), count(10**9, 10**6)

    def frame(self, msgid: int, *fields: object) -> Frame:
        (frame,) = self._decoder.feed(self._encoder.encode(msgid, *fields), next(self._host))  # type: ignore[arg-type]  # test values
        return frame


def telemetry_of(frames: list[Frame], profile: str = "qdrone2") -> Telemetry:
    return SampleDecoder(PROFILES[profile]).step(SampleState(), frames)[1]


def values_of(telemetry: Telemetry, signal: Signal) -> FloatArray:
    return telemetry.need(signal).values


def quaternion(roll: float, pitch: float, yaw: float) -> FloatArray:
    """The product of the three half-angle quaternions, yaw first: an independent way to the same attitude."""
    product = np.array([1.0, 0.0, 0.0, 0.0])
    for angle, axis in ((yaw, 3), (pitch, 2), (roll, 1)):
        w, v = product[0], product[1:]
        half_w, half_v = np.cos(angle / 2), np.zeros(3)
        half_v[axis - 1] = np.sin(angle / 2)
        product = np.concatenate([[w * half_w - v @ half_v], w * half_v + half_w * v + np.cross(v, half_v)])
    return product


@pytest.mark.parametrize("length", [1.0, 0.5, 3.0, -1.0])
def test_quaternions_of_any_length_give_their_angles(length: float) -> None:
    angles = np.random.default_rng(4).uniform([-3, -1.5, -3], [3, 1.5, 3], (50, 3))
    q = length * np.array([quaternion(*row) for row in angles])
    np.testing.assert_allclose(euler_angles(q), angles, atol=1e-12)


def test_a_quaternion_at_the_pole_is_finite_and_a_zero_one_is_not() -> None:
    angles = euler_angles(np.array([quaternion(0.0, pi / 2, 0.0), np.zeros(4)]))
    assert angles[0, 1] == pytest.approx(pi / 2, abs=1e-7)
    assert np.isnan(angles[1]).all()


IMU_CASES = [
    ("qdrone2", MessageId.RAW_IMU, 1e-3 * G, 1e-3),
    ("ardupilot", MessageId.RAW_IMU, 1e-3 * G, 1e-3),
    ("spec", MessageId.RAW_IMU, G / 2048, radians(1 / 16.4)),
    ("px4", MessageId.HIGHRES_IMU, 1.0, 1.0),
]


@pytest.mark.parametrize(("profile", "message", "accel_unit", "gyro_unit"), IMU_CASES)
def test_imu_scales(profile: str, message: MessageId, accel_unit: float, gyro_unit: float) -> None:
    frames = [Vehicle().frame(message, 5_000_000, 1, -2, -1000, 4, -5, 6, 0, 0, 0)]
    telemetry = telemetry_of(frames, profile)
    np.testing.assert_allclose(values_of(telemetry, Signal.SPECIFIC_FORCE), accel_unit * np.array([[1, -2, -1000]]))
    np.testing.assert_allclose(values_of(telemetry, Signal.BODY_RATE), gyro_unit * np.array([[4, -5, 6]]))
    assert telemetry.need(Signal.BODY_RATE).t_ns.tolist() == [5_000_000_000]


@pytest.mark.parametrize("name", ["qdrone2", "spec", "px4"])
def test_imu_round_trip_to_the_quantum(name: str) -> None:
    profile, vehicle = PROFILES[name], Vehicle()
    rng = np.random.default_rng(7)
    force, rate = rng.normal(0, 9, (40, 3)), rng.normal(0, 3, (40, 3))
    counts = np.hstack([force / profile.accel_unit, rate / profile.gyro_unit])
    telemetry = telemetry_of([vehicle.frame(profile.imu, k, *row) for k, row in enumerate(counts.tolist())], name)
    quantum = 0.5 if profile.imu == MessageId.RAW_IMU else 1e-5
    assert np.abs(values_of(telemetry, Signal.SPECIFIC_FORCE) - force).max() <= quantum * profile.accel_unit * (
        1 + 1e-9
    )
    assert np.abs(values_of(telemetry, Signal.BODY_RATE) - rate).max() <= quantum * profile.gyro_unit * (1 + 1e-9)


def test_the_full_scale_of_the_sensor_fits_the_counts() -> None:
    spec = PROFILES["spec"]
    assert 32768 * spec.accel_unit == pytest.approx(16 * G)
    assert 32768 * spec.gyro_unit == pytest.approx(radians(2000), rel=2e-3)


def test_setpoint_angles_rates_and_thrust() -> None:
    q = tuple(quaternion(0.2, -0.1, 1.0).tolist())
    telemetry = telemetry_of([Vehicle().frame(MessageId.ATTITUDE_TARGET, 7_001, 0, q, 0.1, 0.2, 0.3, 0.55)])
    np.testing.assert_allclose(values_of(telemetry, Signal.ATTITUDE_SETPOINT), [[0.2, -0.1, 1.0]], atol=1e-6)
    np.testing.assert_allclose(values_of(telemetry, Signal.RATE_SETPOINT), [[0.1, 0.2, 0.3]], atol=1e-7)
    np.testing.assert_allclose(values_of(telemetry, Signal.THRUST_SETPOINT), [[0.55]], atol=1e-7)
    assert telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns.tolist() == [7_001_000_000]


@pytest.mark.parametrize(
    ("mask", "absent"),
    [
        (TargetMask.ATTITUDE, {Signal.ATTITUDE_SETPOINT}),
        (TargetMask.BODY_YAW_RATE, {Signal.RATE_SETPOINT}),
        (TargetMask.THROTTLE, {Signal.THRUST_SETPOINT}),
        (TargetMask.THROTTLE | TargetMask.BODY_ROLL_RATE, {Signal.THRUST_SETPOINT, Signal.RATE_SETPOINT}),
    ],
)
def test_what_the_type_mask_ignores_is_no_sample(mask: TargetMask, absent: set[Signal]) -> None:
    vehicle = Vehicle()
    frames = [
        vehicle.frame(MessageId.ATTITUDE_TARGET, 1, 0, LEVEL, 0, 0, 0, 0.5),
        vehicle.frame(MessageId.ATTITUDE_TARGET, 2, mask, LEVEL, 0, 0, 0, 0.5),
    ]
    telemetry = telemetry_of(frames)
    for signal in (Signal.ATTITUDE_SETPOINT, Signal.RATE_SETPOINT, Signal.THRUST_SETPOINT):
        assert len(telemetry.need(signal)) == (1 if signal in absent else 2)


def test_unsound_numbers_are_dropped_and_counted() -> None:
    vehicle, nan = Vehicle(), float("nan")
    frames = [
        vehicle.frame(MessageId.ATTITUDE_TARGET, 1, 0, (0.0,) * 4, 0, 0, 0, 0.5),
        vehicle.frame(MessageId.ATTITUDE_TARGET, 2, 0, LEVEL, nan, 0, 0, 0.5),
        vehicle.frame(MessageId.ATTITUDE_TARGET, 3, TargetMask.ATTITUDE, (nan,) * 4, 0, 0, 0, float("inf")),
        vehicle.frame(MessageId.ATTITUDE_TARGET, 4, 0, LEVEL, 0, 0, 0, 0.5),
    ]
    state, telemetry = SampleDecoder(PROFILES["qdrone2"]).step(SampleState(), frames)
    assert telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns.tolist() == [2_000_000, 4_000_000]
    assert telemetry.need(Signal.RATE_SETPOINT).t_ns.tolist() == [1_000_000, 3_000_000, 4_000_000]
    assert telemetry.need(Signal.THRUST_SETPOINT).t_ns.tolist() == [1_000_000, 2_000_000, 4_000_000]
    assert state.dropped == 3


def test_slow_signals() -> None:
    vehicle = Vehicle()
    frames = [
        vehicle.frame(MessageId.HEARTBEAT, *ARMED),  # before any time is known: no sample
        vehicle.frame(MessageId.ATTITUDE, 4_000, 0.1, 0.2, 0.3, 0, 0, 0),
        vehicle.frame(MessageId.HEARTBEAT, *ARMED),
        vehicle.frame(MessageId.LOCAL_POSITION_NED, 4_010, 1, 2, -3, 0, 0, 0),
        vehicle.frame(MessageId.SYS_STATUS, 0, 0, 0, 0, 14_800),
        vehicle.frame(MessageId.SYS_STATUS, 0, 0, 0, 0, 65_535),
        vehicle.frame(MessageId.SERVO_OUTPUT_RAW, 4_020_000, 0, 1000, 1250, 2000, 900),
        vehicle.frame(MessageId.SERVO_OUTPUT_RAW, 4_020_000, 1, 1000, 1250, 2000, 900),
        vehicle.frame(MessageId.ESC_STATUS, 0, 4_030_000, (600, -600, 0, 60), (0,) * 4, (0,) * 4),
        vehicle.frame(MessageId.VIBRATION, 4_040_000, 1, 2, 3),
    ]
    telemetry = telemetry_of(frames)
    armed = telemetry.need(Signal.ARMED)
    assert (armed.t_ns.tolist(), armed.values.tolist()) == ([4_000_000_000], [[1.0]])
    assert values_of(telemetry, Signal.HEIGHT).tolist() == [[3.0]]
    voltage = telemetry.need(Signal.VOLTAGE)
    assert (voltage.t_ns.tolist(), voltage.values.tolist()) == ([4_010_000_000], [[14.8]])
    assert values_of(telemetry, Signal.ACTUATOR).tolist() == [[0.0, 0.25, 1.0, 0.0]]
    np.testing.assert_allclose(values_of(telemetry, Signal.ROTOR_SPEED), [[20 * pi, 20 * pi, 0.0, 2 * pi]])
    np.testing.assert_allclose(values_of(telemetry, Signal.ATTITUDE), [[0.1, 0.2, 0.3]], atol=1e-7)
    assert telemetry.get(Signal.VIBRATION) is None  # means something only with ArduPilot
    assert values_of(telemetry_of(frames, "ardupilot"), Signal.VIBRATION).tolist() == [[1.0, 2.0, 3.0]]


def test_px4_actuators() -> None:
    frame = Vehicle().frame(MessageId.ACTUATOR_OUTPUT_STATUS, 1, 4, (0.5, 0.25, 1.0, 0.0) + (float("nan"),) * 28)
    assert values_of(telemetry_of([frame], "px4"), Signal.ACTUATOR).tolist() == [[0.5, 0.25, 1.0, 0.0]]


def test_only_the_autopilot_of_a_vehicle_counts() -> None:
    computer, station = Vehicle(compid=191), Vehicle()
    frames = [
        station.frame(MessageId.ATTITUDE, 1),
        computer.frame(MessageId.ATTITUDE, 2),
        computer.frame(MessageId.HEARTBEAT, *ARMED),
        station.frame(MessageId.HEARTBEAT, MavType.GCS, 8, 0, 0, 4, 3),
    ]
    telemetry = telemetry_of(frames)
    assert telemetry.need(Signal.ATTITUDE).t_ns.tolist() == [1_000_000]
    assert telemetry.get(Signal.ARMED) is None


def test_a_second_imu_in_the_same_message_is_left_out() -> None:
    vehicle = Vehicle()
    frames = [vehicle.frame(MessageId.RAW_IMU, k, k, 0, 0, 0, 0, 0, 0, 0, 0, k % 2) for k in range(6)]
    assert len(telemetry_of(frames).need(Signal.BODY_RATE)) == 3


def flight(reboot: bool = False) -> list[Frame]:
    """Two seconds at 100 Hz of everything, optionally with a reboot in the middle."""
    vehicle, frames = Vehicle(), []
    for k in range(200):
        ms = 60_000 + 10 * k if not reboot or k < 110 else 3_000 + 10 * (k - 110)
        frames.append(vehicle.frame(MessageId.ATTITUDE_TARGET, ms, 0, LEVEL, 0, 0, 0, 0.5))
        frames.append(vehicle.frame(MessageId.RAW_IMU, ms * 1000 + 7, k, -k, 3, 4, 5, 6, 0, 0, 0))
        if k % 10 == 0:
            frames.append(vehicle.frame(MessageId.HEARTBEAT, *ARMED))
            frames.append(vehicle.frame(MessageId.ATTITUDE, ms, 0.1))
            frames.append(vehicle.frame(MessageId.SERVO_OUTPUT_RAW, ms * 1000, 0, 1500))
    return frames


@pytest.mark.parametrize("reboot", [False, True])
@pytest.mark.parametrize("size", [1, 7, 100])
def test_how_frames_are_cut_does_not_matter(reboot: bool, size: int) -> None:
    frames = flight(reboot)
    converter = SampleDecoder(PROFILES["qdrone2"])
    whole_state, whole = converter.step(SampleState(), frames)
    state, pieces = SampleState(), []
    for k in range(0, len(frames), size):
        state, piece = converter.step(state, frames[k : k + size])
        pieces.append(piece)
    folded = joined(pieces)
    assert state == whole_state
    assert {s.signal for s in folded.series} == {s.signal for s in whole.series}
    for series in whole.series:
        other = folded.need(series.signal)
        assert other.t_ns.tolist() == series.t_ns.tolist()
        assert other.host_ns.tolist() == series.host_ns.tolist()
        assert other.values.tolist() == series.values.tolist()


def test_all_streams_pass_a_reboot_together() -> None:
    state, telemetry = SampleDecoder(PROFILES["qdrone2"]).step(SampleState(), flight(reboot=True))
    assert state.timeline.reboots == 1
    setpoint, imu = telemetry.need(Signal.ATTITUDE_SETPOINT), telemetry.need(Signal.BODY_RATE)
    assert len(setpoint) == len(imu) == 200
    assert set((imu.t_ns - setpoint.t_ns).tolist()) == {7_000}
    steps = np.diff(setpoint.t_ns)
    assert np.flatnonzero(steps > 10_000_000).tolist() == [109]
    assert steps[109] >= 1_000_000_000


def test_two_vehicles_of_one_name_cost_no_more_than_their_frames() -> None:
    one, other, frames = Vehicle(), Vehicle(), []
    for k in range(3000):
        frames.append(one.frame(MessageId.ATTITUDE, 90_000_000 + k))
        frames.append(other.frame(MessageId.ATTITUDE, k))
    state, telemetry = SampleDecoder(PROFILES["qdrone2"]).step(SampleState(), frames)
    assert state.timeline.reboots >= 2999
    assert len(telemetry.need(Signal.ATTITUDE)) == 6000


def test_frames_of_several_vehicles_are_told_apart() -> None:
    a, b = Vehicle(1), Vehicle(2)
    frames = [a.frame(MessageId.ATTITUDE, 1), b.frame(MessageId.ATTITUDE, 2), a.frame(MessageId.ATTITUDE, 3)]
    assert {sysid: len(own) for sysid, own in by_vehicle(frames).items()} == {1: 2, 2: 1}


def test_only_the_signals_of_interest_are_read() -> None:
    converter = SampleDecoder(PROFILES["ardupilot"], [Signal.BODY_RATE, Signal.VIBRATION])
    assert converter.wanted == {MessageId.RAW_IMU, MessageId.VIBRATION}
    _, telemetry = converter.step(SampleState(), flight())
    assert {series.signal for series in telemetry.series} == {Signal.BODY_RATE, Signal.SPECIFIC_FORCE}


def test_nothing_in_nothing_out() -> None:
    state, telemetry = SampleDecoder(PROFILES["qdrone2"]).step(SampleState(), [])
    assert state == SampleState()
    assert telemetry.series == ()


@pytest.mark.parametrize(
    ("autopilot", "imu", "weight", "period_us", "name"),
    [
        (3, MessageId.RAW_IMU, 1000, 10_000, "ardupilot"),
        (3, MessageId.RAW_IMU, 1000, 1_000, "qdrone2"),  # faster than ArduPilot can
        (0, MessageId.RAW_IMU, 1000, 10_000, "qdrone2"),
        (3, MessageId.RAW_IMU, 2048, 10_000, "spec"),
        (12, MessageId.HIGHRES_IMU, 10, 5_000, "px4"),
        (0, MessageId.HIGHRES_IMU, 10, 5_000, "px4"),
        (0, MessageId.ATTITUDE, 0, 5_000, "qdrone2"),
    ],
)
def test_profile_by_what_is_sent(autopilot: int, imu: MessageId, weight: int, period_us: int, name: str) -> None:
    vehicle = Vehicle()
    frames = [vehicle.frame(MessageId.HEARTBEAT, MavType.QUADROTOR, autopilot, 0, 0, 4, 3)]
    frames += [vehicle.frame(imu, period_us * k, 30, -20, -weight) for k in range(20)]
    assert detect_profile(frames) == name


def test_profiles_by_name() -> None:
    chosen: Profile = profile_named("spec")
    assert chosen is PROFILES["spec"]
    with pytest.raises(UsageError, match="qdrone2, spec, ardupilot, px4"):
        profile_named("betaflight")
