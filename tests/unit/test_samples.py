"""Frames become SI samples: scales to the quantum, masks, clocks, and no dependence on how the frames are cut."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import ROUNDING

from mavdiag.link.clock import MS_32
from mavdiag.link.codec import Decoder, Encoder, Frame, frames_of
from mavdiag.link.messages import MavType, MessageId, ModeFlag, TargetMask
from mavdiag.link.profiles import PROFILES, Evidence, detect_profile, with_imu
from mavdiag.link.samples import SOURCES, Form, Part, SampleDecoder, SampleState, Source, euler_angles, joined
from mavdiag.telemetry import FloatArray, Signal, Telemetry

LEVEL = (1.0, 0.0, 0.0, 0.0)
ARMED = (MavType.QUADROTOR, 3, ModeFlag.SAFETY_ARMED, 5, 4, 3)


class Vehicle:
    """Encodes messages and receives them, a millisecond of host time apart."""

    def __init__(self, sysid: int = 1, compid: int = 1) -> None:
        self._encoder, self._decoder, self.host_ns = Encoder(sysid, compid), Decoder(), 10**9

    def frame(self, msgid: int, *fields: object) -> Frame:
        (frame,) = self._decoder.feed(self._encoder.encode(msgid, *fields), self.host_ns)  # type: ignore[arg-type]  # test values
        self.host_ns += 10**6
        return frame


def telemetry_of(frames: list[Frame], profile: str = "qdrone2") -> Telemetry:
    return SampleDecoder(PROFILES[profile]).step(SampleState(), frames)


def counts(frames: list[Frame]) -> Counter[int]:
    return Counter(frame.msgid for frame in frames)


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


def test_setpoint_angles_rates_and_thrust() -> None:
    q = tuple(quaternion(0.2, -0.1, 1.0).tolist())
    telemetry = telemetry_of([Vehicle().frame(MessageId.ATTITUDE_TARGET, 7_001, 0, q, 0.1, 0.2, 0.3, 0.55)])
    np.testing.assert_allclose(values_of(telemetry, Signal.ATTITUDE_SETPOINT), [[0.2, -0.1, 1.0]], atol=1e-6)
    sent = np.array([q], np.float32).astype(np.float64)
    np.testing.assert_allclose(values_of(telemetry, Signal.ATTITUDE_SETPOINT), euler_angles(sent), rtol=0, atol=1e-15)
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


def test_slow_signals() -> None:
    vehicle = Vehicle()
    frames = [
        vehicle.frame(MessageId.HEARTBEAT, *ARMED),  # before any time is known: no sample
        vehicle.frame(MessageId.ATTITUDE, 4_000, 0.1, 0.2, 0.3, 0, 0, 0),
        vehicle.frame(MessageId.HEARTBEAT, *ARMED),
        vehicle.frame(MessageId.LOCAL_POSITION_NED, 4_010, 1, 2, -3, 0, 0, 0),
        vehicle.frame(MessageId.GLOBAL_POSITION_INT, 4_010, 473_977_418, -85_455_939, 0, 3_000, 0, 0, 0, 0),
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
    assert values_of(telemetry, Signal.POSITION).tolist() == [[1.0, 2.0]]
    np.testing.assert_allclose(np.degrees(values_of(telemetry, Signal.COORDINATES)), [[47.3977418, -8.5455939]])
    assert values_of(telemetry, Signal.MODE).tolist() == [[5.0]]
    voltage = telemetry.need(Signal.VOLTAGE)
    assert (voltage.t_ns.tolist(), voltage.values.tolist()) == ([4_010_000_000], [[14.8]])
    assert values_of(telemetry, Signal.ACTUATOR).tolist() == [[0.0, 0.25, 1.0, 0.0] + [0.0] * 12]
    np.testing.assert_allclose(values_of(telemetry, Signal.ROTOR_SPEED)[:, :4], [[20 * pi, 20 * pi, 0.0, 2 * pi]])
    np.testing.assert_allclose(values_of(telemetry, Signal.ATTITUDE), [[0.1, 0.2, 0.3]], atol=1e-7)
    assert telemetry.get(Signal.VIBRATION) is None  # means something only with ArduPilot
    assert values_of(telemetry_of(frames, "ardupilot"), Signal.VIBRATION).tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("sent", "share"),
    [
        ((1528.4, 1557.8, 1000.0, 2000.0) + (900.0,) * 12, (0.5284, 0.5578, 0.0, 1.0)),  # PX4 in simulation
        ((1528.4, 1557.8, 1100.0, 1200.0) + (1000.0,) * 12, (0.5284, 0.5578, 0.1, 0.2)),
        ((900.0,) * 16, (0.0,) * 4),  # disarmed
        ((1023.5, 512.0, 2047.0, 48.0) + (0.0,) * 12, (0.5, 0.2501, 1.0, 0.0234)),  # DShot
        ((1023.5, 900.0, 1100.0, 1200.0) + (0.0,) * 12, (0.5, 0.4397, 0.5374, 0.5862)),  # DShot, by its unused outputs
        ((0.5, 0.25, 1.0, -1.0) + (0.0,) * 12, (0.5, 0.25, 1.0, 0.0)),
    ],
)
def test_px4_tells_the_unit_of_its_outputs_by_their_values(sent: tuple[float, ...], share: tuple[float, ...]) -> None:
    frame = Vehicle().frame(MessageId.ACTUATOR_OUTPUT_STATUS, 1, 16, sent + (0.0,) * 16)
    found = values_of(telemetry_of([frame], "px4"), Signal.ACTUATOR)
    np.testing.assert_allclose(found, [share + (0.0,) * 12], atol=1e-4)


def flight(reboot: bool = False) -> list[Frame]:
    """Two seconds at 100 Hz of everything, optionally with a reboot in the middle."""
    vehicle, frames = Vehicle(), []
    for k in range(200):
        ms = 60_000 + 10 * k if not reboot or k < 110 else 3_000 + 10 * (k - 110)
        vehicle.host_ns += 3 * 10**9 if reboot and k == 110 else 0
        frames.append(vehicle.frame(MessageId.ATTITUDE_TARGET, ms, 0, LEVEL, 0, 0, 0, 0.5))
        frames.append(vehicle.frame(MessageId.RAW_IMU, ms * 1000 + 7, k, -k, 3, 4, 5, 6, 0, 0, 0))
        if k % 10 == 0:
            frames.append(vehicle.frame(MessageId.HEARTBEAT, *ARMED))
            frames.append(vehicle.frame(MessageId.ATTITUDE, ms, 0.1))
            frames.append(vehicle.frame(MessageId.SERVO_OUTPUT_RAW, ms * 1000, 0, 1500))
    return frames


def test_all_streams_pass_a_reboot_together() -> None:
    state = SampleState()
    telemetry = SampleDecoder(PROFILES["qdrone2"]).step(state, flight(reboot=True))
    assert state.timeline.reboots == 1
    setpoint, imu = telemetry.need(Signal.ATTITUDE_SETPOINT), telemetry.need(Signal.BODY_RATE)
    assert len(setpoint) == len(imu) == 198  # the first ones after it only show the new clock
    assert set((imu.t_ns - setpoint.t_ns).tolist()) == {7_000}
    steps = np.diff(setpoint.t_ns)
    assert np.flatnonzero(steps > 10_000_000).tolist() == [109]
    assert steps[109] >= 1_000_000_000


def test_b7_outputs_lie_on_the_time_of_the_imu_after_80_minutes() -> None:
    """SERVO_OUTPUT_RAW counts 32 bits of microseconds: after 71.6 minutes they lay 71.6 minutes in the past."""
    vehicle, frames = Vehicle(), []
    for k in range(50):
        ms = 4_800_000 + 10 * k
        frames.append(vehicle.frame(MessageId.SERVO_OUTPUT_RAW, 1000 * ms % (1 << 32), 0, 1500 + k))
        frames.append(vehicle.frame(MessageId.RAW_IMU, 1000 * ms, 1, 2, 3))
    for size in (1, 2, 7, 100):
        decoder, state = SampleDecoder(PROFILES["qdrone2"]), SampleState()
        pieces = [decoder.step(state, frames[k : k + size]) for k in range(0, len(frames), size)]
        imu, outputs = (joined(pieces).need(signal) for signal in (Signal.BODY_RATE, Signal.ACTUATOR))
        assert outputs.t_ns.tolist() == imu.t_ns[1:].tolist()  # the first came before any time was known
        np.testing.assert_allclose(outputs.values[:, 0], 0.5 + 1e-3 * np.arange(1, 50))


@pytest.mark.parametrize(
    ("autopilot", "imu", "weight", "period_us", "name"),
    [
        (3, MessageId.RAW_IMU, 1000, 10_000, "ardupilot"),
        (3, MessageId.RAW_IMU, 1000, 1_000, "qdrone2"),  # faster than ArduPilot can
        (0, MessageId.RAW_IMU, 1000, 10_000, "qdrone2"),
        (3, MessageId.RAW_IMU, 2048, 10_000, "spec"),
        (12, MessageId.HIGHRES_IMU, 10, 5_000, "px4"),
        (0, MessageId.HIGHRES_IMU, 10, 5_000, "px4"),
        (3, MessageId.ATTITUDE, 0, 5_000, "ardupilot"),
        (12, MessageId.SCALED_IMU, 1000, 5_000, "px4"),
    ],
)
def test_profile_by_what_is_sent(autopilot: int, imu: MessageId, weight: int, period_us: int, name: str) -> None:
    vehicle = Vehicle()
    frames = [vehicle.frame(MessageId.HEARTBEAT, MavType.QUADROTOR, autopilot, 0, 0, 4, 3)]
    frames += [vehicle.frame(imu, period_us * k, 30, -20, -weight) for k in range(20)]
    assert detect_profile(Evidence().take(frames_of(frames))) == (PROFILES[name], "")


@pytest.mark.parametrize(
    ("imu", "weight", "words"),
    [
        (MessageId.ATTITUDE, 0, "sends no IMU message"),
        (MessageId.RAW_IMU, 16_384, "RAW_IMU counts 16384 at rest"),
        (MessageId.RAW_IMU, 0, "RAW_IMU counts"),
        (MessageId.SCALED_IMU, 1000, "sends SCALED_IMU"),
    ],
)
def test_b18_an_unknown_vehicle_is_not_a_qdrone2(imu: MessageId, weight: int, words: str) -> None:
    vehicle = Vehicle()
    frames = [vehicle.frame(MessageId.HEARTBEAT, MavType.QUADROTOR, 0, 0, 0, 4, 3)]
    frames += [vehicle.frame(imu, 1000 * k, 3, -2, -weight) for k in range(20)]
    profile, reason = detect_profile(Evidence().take(frames_of(frames)))
    assert profile is None
    assert words in reason
    assert reason.endswith("give --profile")


def test_b19_one_imu_message_is_chosen_and_never_two() -> None:
    vehicle, ardupilot, frames = Vehicle(), PROFILES["ardupilot"], []
    for k in range(100):
        frames.append(vehicle.frame(MessageId.RAW_IMU, 1000 * k, 1))
        frames += [vehicle.frame(m, k, 7) for m in (MessageId.SCALED_IMU2, MessageId.SCALED_IMU3)]
    assert with_imu(ardupilot, counts(frames)) is ardupilot
    assert len(telemetry_of(frames, "ardupilot").need(Signal.BODY_RATE)) == 100
    scaled = [frame for frame in frames if frame.msgid != MessageId.RAW_IMU]
    assert with_imu(ardupilot, counts(scaled)).imu is MessageId.SCALED_IMU2
    seldom_raw = [*scaled, *(frame for frame in frames[:9] if frame.msgid == MessageId.RAW_IMU)]
    assert with_imu(ardupilot, counts(seldom_raw)).imu is MessageId.SCALED_IMU2
    assert with_imu(ardupilot, counts(scaled[:4]), least=20) is ardupilot


def test_a_message_is_added_by_one_row() -> None:
    row = Source(MessageId.ATTITUDE_QUATERNION, (Part(Signal.ATTITUDE, "q1", Form.ANGLES),), ("time_boot_ms", MS_32))
    frame = Vehicle().frame(MessageId.ATTITUDE_QUATERNION, 5, *quaternion(0.1, 0.2, 0.3).tolist())
    decoder = SampleDecoder(PROFILES["qdrone2"], table=(*SOURCES, row))
    telemetry = decoder.step(SampleState(), [frame])
    np.testing.assert_allclose(telemetry["attitude"].values, [[0.1, 0.2, 0.3]], atol=1e-6)


def test_an_autopilot_is_added_by_one_row() -> None:
    def recognise(seen: Evidence) -> bool:
        return 99 in seen.autopilots

    row = replace(PROFILES["px4"], name="made", autopilot=99, recognise=recognise, imu=MessageId.SCALED_IMU)
    vehicle = Vehicle()
    frames = [vehicle.frame(MessageId.HEARTBEAT, MavType.QUADROTOR, 99, 0, 0, 4, 3)]
    assert detect_profile(Evidence().take(frames_of(frames)), (row, *PROFILES.values()))[0] is row
    assert detect_profile(Evidence().take(frames_of(frames)))[0] is None


EPOCH_US = 1_763_000_000_000_000
WRAP_US = 1 << 32


def streams(seed: int, epoch_imu: bool) -> list[Frame]:
    """Five seconds round the wrap of 32-bit microseconds: late frames, lost ones, a reboot; IMU maybe on unix time."""
    rng, encoder, decoder = np.random.default_rng(seed), Encoder(1, 1), Decoder()
    reboot, frames, host_ns = int(rng.integers(100, 400)), [], 10**18
    for k in range(500):
        boot_us = WRAP_US - 2_000_000 + 10_000 * k if k < reboot else 4_000_000 + 10_000 * (k - reboot)
        late_us = int(rng.integers(0, 3)) * 10_000
        host_ns += int(rng.integers(1_000_000, 19_000_000)) + (3_000_000_000 if k == reboot else 0)
        data = b""
        if rng.random() < 0.95:
            data += encoder.encode(MessageId.ATTITUDE_TARGET, (boot_us - late_us) // 1000, 0, (1.0, 0.1, 0.0, 0.0))
        stamp_us = EPOCH_US + 10_000 * k if epoch_imu else boot_us
        data += encoder.encode(MessageId.RAW_IMU, stamp_us, k, -k)
        if k % 7 == 0:
            data += encoder.encode(MessageId.SERVO_OUTPUT_RAW, boot_us % WRAP_US, 0, 1500)
        if k % 11 == 0:
            data += encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, 3, 128)
        frames += decoder.feed(data, host_ns)
    return frames


def two_paths(seed: int) -> list[Frame]:
    """A streams over two paths, the second up to 3 s behind, with a reboot that both show."""
    rng = np.random.default_rng(seed)
    behind_ns, frames = int(rng.integers(0, 3_000_000_000)), streams(seed, epoch_imu=False)
    late = [frame._replace(host_ns=frame.host_ns + behind_ns) for frame in frames]
    return sorted(frames + late, key=lambda frame: frame.host_ns)


def same(one: Telemetry, other: Telemetry) -> bool:
    return {s.signal for s in one.series} == {s.signal for s in other.series} and all(
        np.array_equal(series.t_ns, other.need(series.signal).t_ns)
        and np.array_equal(series.host_ns, other.need(series.signal).host_ns)
        and np.allclose(series.values, other.need(series.signal).values, rtol=0.0, atol=ROUNDING, equal_nan=True)
        for series in one.series
    )


def held(state: SampleState) -> tuple[bytes, bytes]:
    return state.timeline.words.tobytes(), state.memory.tobytes()


MADE = (lambda seed: streams(seed, False), lambda seed: streams(seed, True), two_paths)


@settings(max_examples=12)
@pytest.mark.parametrize("made", MADE, ids=["boot", "epoch", "two paths"])
@given(st.integers(0, 10**6), st.lists(st.integers(1, 300), min_size=1, max_size=8))
def test_b9_how_frames_are_cut_does_not_matter(made: Callable[[int], list[Frame]], seed: int, sizes: list[int]) -> None:
    frames, converter = made(seed), SampleDecoder(PROFILES["qdrone2"])
    whole_state = SampleState()
    whole = converter.step(whole_state, frames)
    state, pieces, at, k = SampleState(), [], 0, 0
    while at < len(frames):
        size = sizes[k % len(sizes)]
        pieces.append(converter.step(state, frames[at : at + size]))
        at, k = at + size, k + 1
    assert held(state) == held(whole_state)
    assert state.timeline.reboots == 1 or made is two_paths
    assert same(joined(pieces), whole)


ids = st.sampled_from(sorted(frozenset().union(*(SampleDecoder(profile).wanted for profile in PROFILES.values()))))


@settings(max_examples=100)
@given(st.lists(ids, max_size=40), st.integers(0, 2**32))
def test_no_payload_raises(messages: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {msgid: len(Decoder().feed(Encoder(1, 1).encode(msgid), 0)[0].payload) for msgid in messages}
    hosts = np.sort(rng.integers(0, 1 << 62, len(messages))).tolist()
    frames = [Frame(m, 1, 1, 0, rng.bytes(sizes[m]), host_ns) for m, host_ns in zip(messages, hosts, strict=True)]
    for profile in PROFILES.values():
        state = SampleState()
        telemetry = SampleDecoder(profile).step(state, frames)
        assert state.dropped >= 0
        assert all(np.isfinite(s.values).all() for s in telemetry.series if s.signal is not Signal.ROTOR_SPEED)
    found, reason = detect_profile(Evidence().take(frames_of(frames)))
    assert (found is None) == (reason != "")
