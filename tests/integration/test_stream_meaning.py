"""What the plant sends means what it measured: read back by the library's converter, checked by other formulas."""

import itertools
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from made_telemetry import ROUNDING
from scipy.signal import butter, lfilter

from mavdiag.link.codec import UNKNOWN, Decoder, Encoder, Frame, field_index
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.telemetry import FloatArray, Signal, Telemetry
from sitl_plant.autopilot.dialect import DIALECTS, Esc, dialect_named
from sitl_plant.autopilot.stream import ImuFilters, _EscFrames, messages_due
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.emulator import recorded
from sitl_plant.options import FlightPlan
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

N = 3000  # samples: 3 s of a square flown with a badly unbalanced rotor
EVERY_PROFILE = pytest.mark.parametrize("profile", list(PROFILES))
SECONDS = 3.0
CONFIG = PlantConfig(fault="F1/SV3", rotor=2, seed=5, heading_rad=0.7)
LINKS = [("qdrone2", None), ("qdrone2", 250.0), ("spec", 1000.0), ("ardupilot", 50.0), ("px4", 160.0)]


@cache
def flight() -> PlantSamples:
    return Plant(PlantConfig(fault="F1/SV3", rotor=2, seed=5)).advance(N)


def decoded(profile: str) -> list[Frame]:
    dialect, decoder, encode = DIALECTS[profile], Decoder(), Encoder(1, 1).encode_payload
    filtered = ImuFilters(dialect, seed=3).step(flight().rows(0, N))
    messages = [
        (one.t_ns, encode(one.msgid, one.payload)) for one in messages_due(filtered, dialect.schedule(None), dialect)
    ]
    frames = [frame for t_ns, data in messages for frame in decoder.feed(data, t_ns)]
    assert decoder.garbage_bytes == 0
    (count,) = decoder.senders.values()
    assert UNKNOWN not in count.by_message
    assert (count.lost, count.reordered, count.duplicated) == (0, 0, 0)
    return frames


def telemetry(profile: str) -> Telemetry:
    return telemetry_of(decoded(profile), profile)


def values_of(frames: Sequence[Frame], msgid: int, *names: str) -> FloatArray:
    places = [field_index(msgid, name) for name in names]
    return np.array([[frame.fields[place] for place in places] for frame in frames if frame.msgid == msgid], float)


def test_an_esc_tells_its_speed_in_its_turn_in_steps_and_again_what_was_lost() -> None:
    """However the flight is cut."""
    samples, esc = flight(), Esc(lost=0.2)
    whole = _EscFrames(esc, 5).step(samples.t_ns, samples.rotor_speed)
    cut, at = _EscFrames(esc, 5), [0, 7, 8, 250, N]
    parts = [cut.step(samples.t_ns[a:b], samples.rotor_speed[a:b]) for a, b in itertools.pairwise(at)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    step = esc.step_rpm * np.pi / 30
    for rotor, told in enumerate(whole.T):
        changes = np.flatnonzero(np.diff(told, prepend=np.nan) != 0)
        changes = changes[np.isfinite(told[changes])][1:]  # the first one was told before
        np.testing.assert_allclose(told[changes], samples.rotor_speed[changes, rotor], atol=0.51 * step)
        phases = (samples.t_ns[changes] / 1e9 - 0.1 * rotor / 4) % 0.1
        assert np.minimum(phases, 0.1 - phases).max() < 0.0011
        np.testing.assert_allclose(told[changes] / step, np.rint(told[changes] / step), atol=1e-6)


@EVERY_PROFILE
def test_the_converter_reads_back_what_the_plant_measured(profile: str) -> None:
    heard, samples, table = telemetry(profile), flight(), PROFILES[profile]
    spoken = values_of(decoded(profile), MessageId.HEARTBEAT, "type", "autopilot", "mavlink_version")
    assert spoken[0].tolist() == [2, table.autopilot, 3]
    expected: list[tuple[Signal, FloatArray, float]] = [
        (Signal.ATTITUDE_SETPOINT, samples.setpoint, 2e-6),  # float32
        (Signal.RATE_SETPOINT, samples.rate_setpoint, 2e-6),
        (Signal.THRUST_SETPOINT, samples.thrust_setpoint[:, None], 1e-7),
        (Signal.ATTITUDE, samples.attitude[:, :3], 1e-6),
        (Signal.HEIGHT, -samples.position[:, 2:], 1e-6),
        (Signal.ACTUATOR, samples.duty, 0.5e-3 * 1.001),  # whole microseconds of 1000
        (Signal.VOLTAGE, samples.battery_v[:, None], 0.5e-3 * 1.001),  # whole millivolts
    ]
    if DIALECTS[profile].esc is None:
        expected += [(Signal.ROTOR_SPEED, samples.rotor_speed, np.pi / 60 * 1.001)]  # whole rpm
    if table.imu_corner_hz is None:
        unit = (table.gyro_unit, table.accel_unit) if table.imu is MessageId.RAW_IMU else (4e-7, 4e-6)
        expected += [(Signal.BODY_RATE, samples.gyro, 0.501 * unit[0])]
        expected += [(Signal.SPECIFIC_FORCE, samples.accel, 0.501 * unit[1])]
    for signal, truth, tolerance in expected:
        series = heard.need(signal)
        rows = (series.host_ns - int(samples.t_ns[0])) // 1_000_000  # the tests' host clock is the samples' own
        columns = truth.shape[1]
        np.testing.assert_allclose(series.values[:, :columns], truth[rows], rtol=0, atol=tolerance, err_msg=signal)
        assert not np.nan_to_num(series.values[:, columns:]).any()  # outputs and rotors that are not there


@EVERY_PROFILE
def test_stamps_are_of_the_sample_or_of_the_sending(profile: str) -> None:
    table, dialect = PROFILES[profile], DIALECTS[profile]
    frames = [frame for frame in decoded(profile) if frame.msgid == table.imu]
    late_us = values_of(frames, table.imu, "time_usec")[:, 0] - np.array([frame.host_ns for frame in frames]) / 1e3
    if dialect.send_delay_s:
        assert np.ptp(late_us) > 0.5e6 * dialect.send_delay_s
        assert 0 <= late_us.min() <= late_us.max() < 1e6 * dialect.send_delay_s
    else:
        assert np.all(late_us == 0)


def test_ardupilots_imu_is_low_passed_at_20_hz() -> None:
    heard, samples = telemetry("ardupilot"), flight()
    b, a = butter(2, 20.0, fs=1000.0)
    settled = 500  # the two filters start differently
    for signal, raw, unit in ((Signal.BODY_RATE, samples.gyro, 1e-3), (Signal.SPECIFIC_FORCE, samples.accel, 9.81e-3)):
        series = heard.need(signal)
        rows = (series.host_ns - int(samples.t_ns[0])) // 1_000_000
        expected = lfilter(b, a, raw - raw[0], axis=0) + raw[0]
        late = rows > settled
        np.testing.assert_allclose(series.values[late], expected[rows[late]], rtol=0, atol=0.55 * unit)


def test_the_vibration_level_is_ardupilots() -> None:
    """AP_InertialSensor::calc_vibration_and_clipping, sample by sample."""
    accel = flight().accel
    floor, level = accel[0].copy(), np.zeros(3)
    dt = 1e-3
    alpha_floor, alpha_level = dt / (dt + 1 / (2 * np.pi * 5.0)), dt / (dt + 1 / (2 * np.pi * 2.0))
    vibe = []
    for a in accel:
        floor += alpha_floor * (a - floor)
        level += alpha_level * ((a - floor) ** 2 - level)
        vibe.append(np.sqrt(level))
    sent = values_of(decoded("ardupilot"), MessageId.VIBRATION, "vibration_x", "vibration_y", "vibration_z")
    np.testing.assert_allclose(sent, np.array(vibe)[::100][: len(sent)], rtol=1e-3, atol=1e-9)
    assert sent[-1, 0] > 0.5  # m/s^2: the damaged rotor shakes


def frames_of(config: PlantConfig, profile: str, rate_hz: float, seconds: float = 1.0) -> list[Frame]:
    decoder, plan = Decoder(), FlightPlan(config, dialect_named(profile), rate_hz)
    return [frame for t_ns, data in recorded(plan, seconds, lambda _: None) for frame in decoder.feed(data, t_ns)]


def telemetry_of(frames: list[Frame], profile: str) -> Telemetry:
    return SampleDecoder(PROFILES[profile]).step(SampleState(), frames)


@pytest.mark.parametrize(("profile", "rate_hz"), LINKS)
def test_times_and_values_are_those_of_the_wire(profile: str, rate_hz: float | None) -> None:
    direct, _ = flight_telemetry(CONFIG, SECONDS, LinkSpec(profile, rate_hz))
    wire = telemetry_of(frames_of(CONFIG, profile, rate_hz or PROFILES[profile].rate_hz, SECONDS), profile)
    compared = {series.signal for series in direct.series} - {Signal.ARMED, Signal.MODE}
    assert {Signal.ATTITUDE_SETPOINT, Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ACTUATOR} <= compared
    assert (Signal.VIBRATION in compared) == PROFILES[profile].vibration
    for signal in compared:
        ours, theirs = direct.need(signal), wire.need(signal)
        untimed = signal is Signal.VOLTAGE or (signal is Signal.ROTOR_SPEED and profile == "ardupilot")
        if not untimed:
            np.testing.assert_array_equal(ours.t_ns, theirs.t_ns, err_msg=signal)
        np.testing.assert_allclose(ours.values[-len(theirs) :], theirs.values, rtol=0.0, atol=ROUNDING, err_msg=signal)
        assert len(ours) - len(theirs) in ((0, 1) if untimed else (0,))
