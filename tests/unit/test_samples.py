"""Frames become SI samples, whatever their clocks do: scales, masks, wraps, drifts, and however the frames are cut."""

import collections
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import ROUNDING
from scipy.spatial.transform import Rotation

from mavdiag.link import samples
from mavdiag.link.clock import _BOOT_US_32, MS_32, NEVER, US_32, US_64, Counter, VehicleTime
from mavdiag.link.codec import Decoder, Encoder, Frame, Frames, frames_of, layout_of
from mavdiag.link.messages import MavType, MessageId, ModeFlag, TargetMask
from mavdiag.link.profiles import PROFILES, Evidence, detect_profile, with_imu
from mavdiag.link.samples import SOURCES, Form, Part, SampleDecoder, SampleState, Source, euler_angles, joined
from mavdiag.link.sequence import FRAME
from mavdiag.link.vehicles import VehicleStream
from mavdiag.telemetry import FloatArray, IntArray, Signal, Telemetry

LEVEL = (1.0, 0.0, 0.0, 0.0)
ARMED = (MavType.QUADROTOR, 3, ModeFlag.SAFETY_ARMED, 5, 4, 3)
EPOCH_US = 1_763_000_000_000_000  # a day in November 2025
WRAP_US = 1 << 32
ids = st.sampled_from(sorted(frozenset().union(*(SampleDecoder(profile).wanted for profile in PROFILES.values()))))
Stream = tuple[Counter, IntArray, IntArray]  # counts and times of arrival [ns]
S = 1_000_000_000
MS = 1_000_000
ALONE = (Signal.HEIGHT, Signal.VOLTAGE)  # of one column
EPOCH_NS = 1_763_000_000 * S


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


def counts(frames: list[Frame]) -> collections.Counter[int]:
    return collections.Counter(frame.msgid for frame in frames)


def values_of(telemetry: Telemetry, signal: Signal) -> FloatArray:
    return telemetry.need(signal).values


def quaternion(roll: float, pitch: float, yaw: float) -> FloatArray:
    """By scipy."""
    return np.roll(Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_quat(), 1)


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
        ((999.5, 512.0, 1999.0, 48.0) + (0.0,) * 12, (0.5, 0.2561, 1.0, 0.024)),  # DShot
        ((1523.5, 900.0, 1100.0, 1200.0) + (0.0,) * 12, (0.5235, 0.0, 0.1, 0.2)),  # PWM, as in a log of px4_real
        ((0.5, 0.25, 1.0, -1.0) + (0.0,) * 12, (0.5, 0.25, 1.0, 0.0)),
    ],
)
def test_px4_tells_the_unit_of_its_outputs_by_their_values(sent: tuple[float, ...], share: tuple[float, ...]) -> None:
    frame = Vehicle().frame(MessageId.ACTUATOR_OUTPUT_STATUS, 1, 16, sent + (0.0,) * 16)
    found = values_of(telemetry_of([frame], "px4"), Signal.ACTUATOR)
    np.testing.assert_allclose(found, [share + (0.0,) * 12], atol=1e-4)


@pytest.mark.parametrize(
    ("protocol", "sent", "shares"),
    [(400, (0.0, 110.0, 999.5, 1999.0, 1.0), (0.0, 0.055, 0.5, 1.0, 0.0005)), (-1, [1499.25], [0.49925])]
    + [(protocol, [1499.25], [0.75]) for protocol in (-5, -2)],
)
def test_dshot_is_known_by_idling_or_a_parameter(protocol: int, sent: Sequence[float], shares: Sequence[float]) -> None:
    vehicle, stream = Vehicle(), VehicleStream(PROFILES["px4"])
    for name, value in (("PWM_AUX_TIM0", protocol), ("PWM_AUX_FUNC3", 101)):
        talk = vehicle.frame(MessageId.PARAM_VALUE, name, *struct.unpack("<f", struct.pack("<i", value)), 6, 2, 0)
        stream.step(frames_of([talk]), [talk])
    frames = [vehicle.frame(MessageId.ACTUATOR_OUTPUT_STATUS, 1, 4, (one,) * 4 + (0.0,) * 28) for one in sent]
    found = values_of(stream.step(frames_of(frames)), Signal.ACTUATOR)
    np.testing.assert_allclose(found[:, :4], np.outer(shares, np.ones(4)), atol=1e-4)


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
    ("autopilot", "imu", "weight", "period_us", "name", "words"),
    [
        (3, MessageId.RAW_IMU, 1000, 4_000, "ardupilot", ""),
        (3, MessageId.RAW_IMU, 1000, 1_000, "qdrone2", ""),  # faster than ArduPilot can
        (0, MessageId.RAW_IMU, 1000, 10_000, "qdrone2", ""),
        (3, MessageId.RAW_IMU, 2048, 10_000, "spec", ""),
        (12, MessageId.HIGHRES_IMU, 10, 5_000, "px4", ""),
        (0, MessageId.HIGHRES_IMU, 10, 5_000, "px4", ""),
        (3, MessageId.ATTITUDE, 0, 5_000, "ardupilot", ""),
        (12, MessageId.SCALED_IMU, 1000, 5_000, "px4", ""),
        (0, MessageId.ATTITUDE, 0, 1_000, None, "sends no IMU message"),
        (0, MessageId.RAW_IMU, 16_384, 1_000, None, "RAW_IMU counts 16384 at rest"),
        (0, MessageId.RAW_IMU, 0, 1_000, None, "RAW_IMU counts"),
        (0, MessageId.SCALED_IMU, 1000, 1_000, None, "sends SCALED_IMU"),
    ],
)
def test_b18_profile_by_what_is_sent(
    autopilot: int, imu: MessageId, weight: int, period_us: int, name: str | None, words: str
) -> None:
    vehicle = Vehicle()
    frames = [vehicle.frame(MessageId.HEARTBEAT, MavType.QUADROTOR, autopilot, 0, 0, 4, 3)]
    frames += [vehicle.frame(imu, period_us * (2 * k % 21) // 2, 30, -20, -weight) for k in range(20)]  # a reboot at 11
    profile, reason = detect_profile(Evidence().take(frames_of(frames)))
    assert profile is (None if name is None else PROFILES[name])
    assert words in reason
    assert bool(reason) != bool(name)


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
    np.testing.assert_allclose(decoder.step(SampleState(), [frame])["attitude"].values, [[0.1, 0.2, 0.3]], atol=1e-6)


def test_an_autopilot_is_added_by_one_row() -> None:
    def recognise(seen: Evidence) -> bool:
        return 99 in seen.autopilots

    row = replace(PROFILES["px4"], name="made", autopilot=99, recognise=recognise, imu=MessageId.SCALED_IMU)
    frames = [Vehicle().frame(MessageId.HEARTBEAT, MavType.QUADROTOR, 99, 0, 0, 4, 3)]
    assert detect_profile(Evidence().take(frames_of(frames)), (row, *PROFILES.values()))[0] is row
    assert detect_profile(Evidence().take(frames_of(frames)))[0] is None


def streams(seed: int, epoch_imu: bool) -> list[Frame]:
    """Five seconds round the wrap of 32-bit microseconds: late frames, lost ones, a reboot; IMU maybe on unix time."""
    rng, encoder, decoder = np.random.default_rng(seed), Encoder(1, 1), Decoder()
    reboot, frames, host_ns = int(rng.integers(100, 400)), list[Frame](), 10**18
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
    found, expected = (one.timeline.words.tobytes() + one.memory.tobytes() for one in (state, whole_state))
    assert found == expected
    assert state.timeline.reboots == 1 or made is two_paths
    assert same(joined(pieces), whole)


@settings(max_examples=100)
@given(st.lists(ids, max_size=40), st.integers(0, 2**32))
def test_no_payload_raises(messages: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {msgid: layout_of(msgid).packer.size for msgid in messages}
    hosts = np.sort(rng.integers(0, 1 << 62, len(messages))).tolist()
    frames = [Frame(m, 1, 1, 0, rng.bytes(sizes[m]), host_ns) for m, host_ns in zip(messages, hosts, strict=True)]
    for profile in PROFILES.values():
        state = SampleState()
        telemetry = SampleDecoder(profile).step(state, frames)
        assert all(np.isfinite(s.values).all() for s in telemetry.series if s.signal is not Signal.ROTOR_SPEED)
    found, reason = detect_profile(Evidence().take(frames_of(frames)))
    assert (found is None) == (reason != "")


def taken(*streams: Stream, size: int = 1 << 30) -> tuple[VehicleTime, list[IntArray]]:
    """The time after these streams, a message each, and of each stamp or `NEVER`. size: stamps at a time."""
    # Of two numbers: the count, and the stamp's own, which is the only signal of its message.
    table = [(16, counter.tick_ns, counter.turn, 0, -1, k, k + 1) for k, (counter, _, _) in enumerate(streams)]
    parts = [(list(Signal).index(one), Form.VECTOR, 8, 0, 8, -1, 1, 0, 0, 0, 1.0, 0.0) for one in ALONE[: len(streams)]]
    decoder, state, lookup = SampleDecoder(PROFILES["px4"]), SampleState(), np.arange(len(streams), dtype=np.int16)
    records = np.array(table, samples._SOURCE), np.array(parts, samples._PART)
    decoder._table = lookup, *records, samples._WIDTHS
    raw, host_ns = (np.concatenate(columns) for columns in list(zip(*streams, strict=True))[1:])
    order, ends = np.argsort(host_ns, kind="stable"), np.cumsum([len(raw) for _, raw, _ in streams])
    rows, times = np.zeros(len(raw), FRAME), np.full(len(raw), NEVER)
    rows["host_ns"], rows["row"], rows["sender"] = host_ns[order], np.searchsorted(ends, order, "right"), 1
    rows["body"], rows["stop"] = 16 * np.arange(len(raw)), 16 * np.arange(1, len(raw) + 1)
    frames = Frames(np.frombuffer(np.stack([raw[order], order], axis=1).tobytes(), np.uint8), rows)
    for at in range(0, len(raw), size):
        for series in decoder.step(state, frames.where(slice(at, at + size))).series:
            times[series.values[:, 0].astype(np.int64)] = series.t_ns
    return state.timeline, np.split(times, ends[:-1])


def ints(values: object) -> IntArray:
    return np.asarray(values, dtype=np.int64)


@pytest.mark.parametrize("size", [1, 3, 5, 7])
def test_a_wrap_is_undone_wherever_the_samples_are_cut(size: int) -> None:
    true = (1 << 32) - 5 + np.arange(10)
    _, (t_ns,) = taken((MS_32, true % (1 << 32), true * MS), size=size)
    assert t_ns.tolist() == (true * MS).tolist()


@pytest.mark.parametrize("silent_s", [4200, 4320, 9000, 30_000])
def test_turns_that_pass_in_silence_are_counted(silent_s: int) -> None:
    """Of 32-bit microseconds, while other messages of the vehicle go on."""
    boot_us = 1_000_000 * np.arange(10, silent_s + 20)
    own_us = boot_us[[5, -2, -1]]
    _, (_, t_ns) = taken((US_64, boot_us, 1000 * boot_us), (US_32, own_us % (1 << 32), 1000 * own_us + MS))
    assert t_ns.tolist() == (1000 * own_us).tolist()


def test_a_message_that_changes_to_unix_time_is_laid_over_its_old_clock() -> None:
    true = np.arange(400) * 10 * MS
    raw = np.where(true < 2 * S, 5_000_000, EPOCH_US) + true // 1000
    time, (t_ns,) = taken((US_64, raw, 77 * S + true))
    assert (t_ns[:200].tolist(), t_ns[200], time.reboots) == ((5 * S + true[:200]).tolist(), NEVER, 0)


@pytest.mark.parametrize("turns", [0, 1, 2, 7])
@pytest.mark.parametrize("error_s", [-1800, 0, 1800])
def test_b7_the_turns_of_a_first_reading_are_chosen_by_the_time_since_boot(turns: int, error_s: int) -> None:
    true_us = turns * (1 << 32) + 2_000_000_000
    boot = (US_64, ints([true_us + error_s * 1_000_000]), ints([0]))
    time, _ = taken(boot, (US_32, ints([true_us % (1 << 32)]), ints([1])))
    assert time.records[2][_BOOT_US_32]["first_ns"] == 1 - true_us * 1000


@pytest.mark.parametrize(
    ("silent_s", "uptime_s", "anew"),
    [(0.5, 0, False), (1.0, 0, True), (1.0, 11, True), (1.0, 12, False), (9.0, 500, False), (10.0, 500, True)],
)
def test_b9_a_vehicle_starts_anew_after_silence(silent_s: float, uptime_s: float, anew: bool) -> None:
    raw = np.concatenate([[900_000], round(1000 * uptime_s) + 10 * np.arange(3)])
    host = np.concatenate([[5 * S], 5 * S + round(silent_s * S) + 10 * MS * np.arange(3)])
    time, (t_ns,) = taken((MS_32, raw, host))
    assert (time.reboots, (t_ns > NEVER).tolist()) == (anew, [True, False, False, anew])


def stream() -> tuple[IntArray, IntArray]:
    """Counts [ms] and times of arrival [ns] of ten seconds at 100 Hz, some milliseconds on the way."""
    true_ms = np.arange(1000) * 10
    way_ns = np.random.default_rng(5).integers(2, 9, len(true_ms)) * MS
    return 60_000 + true_ms, np.sort(77 * S + true_ms * MS + way_ns)


@pytest.mark.parametrize("ahead_ms", [300, 10_000, 25_000, 120_000, 3_600_000, 36_000_000])
@pytest.mark.parametrize("size", [1, 4, 10_000])
def test_a_stamp_that_leaps_is_left_out_and_the_stream_goes_on(ahead_ms: int, size: int) -> None:
    raw, host = stream()
    forged = np.arange(200, 1000, 20)
    mixed = (MS_32, np.insert(raw, forged, raw[forged] + ahead_ms), np.insert(host, forged, host[forged]))
    time, (t_ns,) = taken(mixed, size=size)
    assert (t_ns[t_ns > NEVER].tolist(), time.leaps) == ((raw * MS).tolist(), len(forged))


@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_a_clock_that_was_set_is_followed_when_the_old_one_is_silent_for_a_second(size: int) -> None:
    raw, host = stream()
    raw[500:] += 40_000
    _, (t_ns,) = taken((MS_32, raw, host), size=size)
    kept = t_ns[t_ns > NEVER] // MS
    assert kept[:500].tolist() == raw[:500].tolist()
    assert 1.0 <= (kept[500] - raw[500]) / 1000 < 1.1
    assert kept[500:].tolist() == raw[-len(kept[500:]) :].tolist()


@pytest.mark.parametrize("back_ms", [50, 500, 3000])
@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_a_clock_that_is_set_back_begins_another_piece_once_past_the_highest_stamp(back_ms: int, size: int) -> None:
    (raw, host), first = stream(), 500 + back_ms // 10
    raw[500:] -= back_ms
    time, (t_ns,) = taken((MS_32, raw, host), size=size)
    assert 1.0 <= (t_ns[first] - t_ns[499]) / S < 1.1
    assert (np.diff(t_ns[first:]) == 10 * MS).all()
    assert (time.reboots, t_ns[:500].tolist()) == (0, (raw[:500] * MS).tolist())


def test_late_frames_and_a_burst_whose_newest_stamp_comes_first_are_no_clock_that_is_set_back() -> None:
    raw, host = stream()
    late_ns = host + np.random.default_rng(1).integers(0, 120, len(host)) * MS
    order = np.argsort(late_ns, kind="stable")
    assert taken((MS_32, raw[order], late_ns[order]))[0].backs == 0
    raw[490:500], bursts = np.roll(raw[490:500], 1), np.repeat(host[9::10], 10)
    bursts[491:500] += 90 * MS  # the link stalls
    _, (t_ns,) = taken((MS_32, raw, bursts))
    assert t_ns.tolist() == (raw * MS).tolist()


class Link:
    """Two streams of one vehicle over a link with jitter and loss, and the true time of each sample that arrives.

    reference, other: counter, its time at the start [ns] and its drift [ppm]; step_ns: of the other, after 60 s.
    """

    def __init__(
        self,
        seed: int,
        reference: tuple[Counter, int, float],
        other: tuple[Counter, int, float],
        seconds: int,
        step_ns: int = 0,
    ) -> None:
        rng, true = np.random.default_rng(seed), np.arange(seconds * 50, dtype=np.int64) * (S // 50)
        self.true, self.raw, self.host, self.counters = [], [], [], (reference[0], other[0])
        for k, (counter, start_ns, ppm) in enumerate((reference, other)):
            here = true[(rng.random(len(true)) >= 0.05) & (true >= k * S // 2)]  # the reference comes first
            clock_ns = start_ns + here + np.rint(here * ppm * 1e-6).astype(np.int64)
            clock_ns += np.where(here > 60 * S, k * step_ns, 0)
            raw, delay = clock_ns // counter.tick_ns, 2_000_000 + rng.exponential(4e6, len(here)).astype(np.int64)
            self.true.append(here)
            self.raw.append(raw % counter.turn if counter.turn else raw)
            self.host.append(np.maximum.accumulate(77 * S + here + delay))

    def placed(self) -> tuple[VehicleTime, IntArray, IntArray]:
        """The time after both streams, and the times of those samples of each that have one."""
        streams = [(self.counters[k], self.raw[k], self.host[k]) for k in (0, 1)]
        time, times = taken(*streams)
        self.taken = [true[t_ns > NEVER] for true, t_ns in zip(self.true, times, strict=True)]
        reference, laid = (t_ns[t_ns > NEVER] for t_ns in times)
        return time, reference, laid

    def error_ns(self, start_ns: int, ppm: float, laid: IntArray) -> IntArray:
        """How far the other stream's samples lie from where the reference clock says that they were."""
        true = self.taken[1][-len(laid) :]
        error: IntArray = laid - (start_ns + true + np.rint(true * ppm * 1e-6).astype(np.int64))
        return error


@pytest.mark.parametrize("ppm", [-80.0, 50.0])
def test_a_drift_of_an_hour_is_followed(ppm: float) -> None:
    """50 ppm are 180 ms in an hour; a fixed offset was that wrong."""
    link = Link(11, (MS_32, 3 * S, 0.0), (US_64, EPOCH_NS, ppm), 3600)
    time, reference, laid = link.placed()
    assert np.abs(link.error_ns(3 * S, 0.0, laid)).max() < 3_000_000
    assert np.abs(np.diff(laid - link.true[1][-len(laid) :])).max() < 100_000  # no jump
    assert time.drift_ppm == pytest.approx(ppm, abs=1.0)
    assert reference.tolist() == (3 * S + link.true[0]).tolist()  # the reference's own stamps stay


@pytest.mark.parametrize("step_s", [-0.4, 0.3, 40.0])
def test_a_clock_that_is_set_is_laid_anew_within_seconds(step_s: float) -> None:
    """GPS or a network sets the unix time in flight: no drift explains it, and 5 s would take 10,000 s to slew."""
    link = Link(5, (MS_32, 3 * S, 0.0), (US_64, EPOCH_NS, 20.0), 120, step_ns=round(step_s * S))
    _, _, laid = link.placed()
    error, true = np.abs(link.error_ns(3 * S, 0.0, laid)), link.taken[1][-len(laid) :]
    assert error[true > 65 * S].max() < 3_000_000
    assert error[true < 60 * S].max() < 3_000_000
