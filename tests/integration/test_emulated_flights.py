"""On emulated flights: what is learnt, found and named; the signals of a recorded QDrone 2; what is sent and read."""

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pytest
from broken_teaching import MONITORS, Pool, Tally, judge_sets, pool_of
from made_telemetry import ROUNDING, changed
from scipy.signal import butter, lfilter, welch
from virtual_flight import healthy_flights, taught

import mavdiag as md
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.fingerprint import Outcome, compare, fingerprint_of
from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.chain import chain_of
from mavdiag.decision.alarm import Stage
from mavdiag.errors import InputError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, extend, learn, rows_of
from mavdiag.link.codec import UNKNOWN, Decoder, Encoder, Frame
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows, in_pieces
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import FloatArray, Log, Signal, Telemetry
from mavdiag.units import G
from sitl_plant.autopilot.dialect import DIALECTS, dialect_named
from sitl_plant.autopilot.stream import ImuFilters, _EscFrames, messages_due, records
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.emulator import recorded
from sitl_plant.options import FlightPlan
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.physics.parameters import make_controller
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import airframe_of, vehicle_named

ONSET_S = 12.0  # 5 s after take-off nothing is judged
CRACKS = ("F1/SV1", "F2/SV2", "F3/SV3")
FRONT = Front(AlignSpec(0.001, Grid.NATIVE), GateSpec(min_thrust=0.1), RateSpec.of(0.001, 101))
QDRONE2 = Airframe(layout=layout_named("qdrone2"), mass_kg=1.504, hover_rad_s=1047.2)
NOW = "2026-01-01T00:00:00+00:00"


@cache
def baseline() -> Baseline:
    return parse(dump(taught(range(100, 106), 25.0, "qdrone2")))


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_crack_is_declared_soon_and_its_rotor_named(rotor: int) -> None:
    config = PlantConfig(seed=7, fault="F2/SV2", rotor=rotor, onset_s=ONSET_S)
    verdict = judge(Log("crack", "", "qdrone2", flight_telemetry(config, 26.0)[0]), baseline())
    faults = [one for one in verdict.changes if one.stage is Stage.FAULT]
    assert ONSET_S < faults[0].t_ns / 1e9 < ONSET_S + 3.0
    assert {one.rotor for one in verdict.events if one.rotor is not None} == {rotor}
    assert {one.fault_type for one in faults} <= {None, "F2", "F3"}  # a crack, or what looks like one


@pytest.mark.parametrize("seed", [900, 901, 902])
def test_a_healthy_flight_is_healthy(seed: int) -> None:
    verdict = judge(Log("healthy", "", "qdrone2", flight_telemetry(PlantConfig(seed=seed), 25.0)[0]), baseline())
    assert verdict.verdict is Verdict.HEALTHY, f"seed {seed}: {verdict.reason}"


def fly(seed: int, fault: str | None = None, rotor: int = 1, seconds: float = 16.0) -> list[Rows]:
    config = PlantConfig(drone=1, seed=seed, fault=fault, rotor=rotor, wind_m_s=0.5)
    return list(rows_of(FRONT, flight_telemetry(config, seconds)[0]))


def test_the_lag_of_a_damaged_rotor_is_no_other_wiring() -> None:
    front = Front(AlignSpec(0.01, Grid.NATIVE), GateSpec(min_thrust=0.1), RateSpec.of(0.01, 11))

    def flown(**config: Any) -> list[Rows]:
        return list(rows_of(front, flight_telemetry(PlantConfig(**config), 16.0, LinkSpec("ardupilot", 100.0))[0]))

    lag = Injection(RotorDamage(thrust_factor=0.9, thrust_lag_s=0.06))
    learnt, layout = fingerprint_of([flown(seed=1)], QDRONE2.layout), QDRONE2.layout
    assert learnt is not None
    assert compare(learnt, flown(seed=77, nose="path", injections=(lag,)), layout).outcome is not Outcome.FAR


def test_a_flight_that_turns_its_nose_says_nothing_against_hovers() -> None:
    flights = healthy_flights([1, 11], 40.0, rate_hz=100.0, trajectory="hover")
    flights += healthy_flights([1], 60.0, rate_hz=100.0, trajectory="square", nose="path")
    found = learn(flights, LearnOptions(airframe=QDRONE2), created=NOW)
    assert (found.grade, found.weak) == ("A", "")  # the trim of a nose that always turns lies apart by 11 % of hover
    assert learn(flights[:1], LearnOptions(airframe=QDRONE2), created=NOW).grade == "B"  # one short flight shows less


KINDS = (
    "hover-fixed square-fixed hover-fixed square-path hover-fixed",
    "figure8-path square-path",
    "circle-path hover-fixed",
)


WINDS = [("hover-fixed", "hover-fixed", air) for air in ({"wind_m_s": 5.0}, {"turbulence_m_s": 10.0})]
OTHERS: list[Any] = [(*pair, {}) for kinds in KINDS for pair in itertools.pairwise(kinds.split())]


@pytest.mark.parametrize(("learnt", "flown", "air"), [*OTHERS, *WINDS])
def test_healthy_flights_of_another_kind_or_in_wind_are_no_faults(learnt: str, flown: str, air: dict[str, Any]) -> None:
    (trajectory, nose), (other, its) = learnt.split("-"), flown.split("-")
    base = taught(range(1, 4), 40.0, trajectory=trajectory, nose=nose)
    found = judge(healthy_flights([11], 40.0, trajectory=other, nose=its, **air)[0], base).verdict
    assert found is Verdict.HEALTHY if air else found is not Verdict.FAULT, found


def test_set_points_that_are_stamped_late_are_another_link_and_no_fault() -> None:
    base, (log,) = taught(range(1, 4), 40.0, trajectory="square", nose="path"), healthy_flights([11], 40.0, nose="path")
    late = (
        replace(one, t_ns=one.t_ns + 10**8) if one.signal is Signal.ATTITUDE_SETPOINT else one for one in log.telemetry
    )
    moved = replace(log, sha256="", telemetry=Telemetry(tuple(late)))
    found, state = judge(moved, base), (chain := chain_of(base, profile=log.profile)).start()
    assert (judge(log, base).verdict, found.verdict) == (Verdict.HEALTHY, Verdict.NOT_JUDGEABLE)
    assert re.match(r"another link: set-points (9|10)\d ms later than learnt; ", found.reason), found.reason
    for part in in_pieces(moved.telemetry, 5):
        chain.step(state, part)
    assert state.diagnosis.reason == found.reason
    with pytest.raises(InputError, match="another link"):
        extend(base, [moved], created=NOW)


def test_the_estimated_unbalance_is_that_of_the_table_and_placed() -> None:
    monitor = Unbalance(*Unbalance.fit([fly(11), fly(12)], LearnContext(QDRONE2, None, 0.001, 101)))
    found = [(one.level[one.valid], one.rotors[one.valid]) for one in monitor.over(fly(51, "F3/SV1", 2, seconds=6.0))]
    level, rotors = (np.concatenate(columns) for columns in zip(*found, strict=True))
    assert float(level.mean()) == pytest.approx(3.77, rel=0.15)  # T Table 3.2; own unbalance adds
    assert int(rotors.sum(axis=0).argmax()) + 1 == 2


@cache
def pool() -> Pool:
    """Of an airframe at 1 kHz."""
    return pool_of(7001, 0, 6, CRACKS)


def learnt(*flights: Log) -> Baseline:
    frame = airframe_of(pool().session.airframe.vehicle, "made")
    return learn(flights, LearnOptions(airframe=frame, monitors=MONITORS), created=NOW)


def test_drawn_sets_are_marked_where_one_is_broken_and_nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """A short form of `benchmarks/broken_teaching.py`, on an airframe of a seed of its own."""
    monkeypatch.setattr("broken_teaching.SIZES", (1, 2, 5))
    judge_sets(pool(), 1, np.random.default_rng(7001), tally := Tally())
    for kind, counts in tally.kinds.items():
        if kind.startswith("healthy"):
            assert counts[True] == 0, (kind, tally.wrong)
        elif kind != "one broken of 1":  # physics alone does not show every one
            assert counts[False] == 0, (kind, tally.wrong)


@pytest.mark.parametrize("code", CRACKS)
def test_a_crack_in_one_flight_names_the_flight_and_the_time(code: str) -> None:
    half, broken = pool().half[code], pool().broken[code]
    weak = learnt(half).weak
    assert half.name in weak or "all flights" in weak
    assert f"{broken.name}: " in learnt(pool().healthy[0], broken, pool().healthy[1]).weak


def test_more_unbalance_than_a_rotor_may_have_is_not_learnt() -> None:
    found = learnt(pool().broken["F3/SV3"])
    assert (found.grade, "grade G40" in found.weak) == ("D", True)


def weakened(log: Log, rotor: int, loss: float) -> Log:
    """The log with a rotor that lost thrust at half: its command rises, that of all together stays."""
    t_ns, rise = log.telemetry.need(Signal.ACTUATOR).t_ns, 1 / np.sqrt(1 - loss) - 1
    late = (t_ns > (t_ns[0] + t_ns[-1]) // 2)[:, None] * np.eye(32)[rotor - 1]
    told = changed(
        log.telemetry, Signal.ACTUATOR, lambda x: x + rise * late[:, : x.shape[1]] * x[:, :4].mean(1)[:, None]
    )
    return replace(log, name="weakened", sha256="", telemetry=told)


def test_what_the_baseline_says_that_it_notices_it_notices() -> None:
    baseline = learnt(*pool().healthy[:4])
    assert baseline.least_damage is not None
    fresh = pool().healthy[5]
    assert md.judge(fresh, baseline).verdict == "healthy"
    for rotor, loss in enumerate(baseline.least_damage.thrust_loss, 1):
        assert 0.005 < loss < 0.2
        assert md.judge(weakened(fresh, rotor, 0.3 * loss), baseline).verdict == "healthy"
        assert md.judge(weakened(fresh, rotor, 1.6 * loss + 0.01), baseline).verdict != "healthy"


VEHICLE = vehicle_named("qdrone2-recorded")
FLIGHT_S = 88.0  # as F0_SV0_SP1_t1_D1_R1
ARM_MS, LIFT_MS, CUT_MS, FLYING = 3300, 10500, 14000, 2  # of its timeline; the first 14 s are cut
PUBLISHED = {  # roll gyro, rad/s rms in 50-100, 100-200, 200-500 Hz
    1: ((0.0123, 0.0398, 0.0203), (0.0120, 0.0310, 0.0158), (0.0124, 0.0312, 0.0159)),
    2: ((0.0140, 0.0192, 0.0105),),
    3: ((0.0125, 0.0179, 0.0097),),
}


@lru_cache(maxsize=2)  # a flight takes 40 MB
def flight(trajectory: str = "t2-sp1", drone: int = 1, seed: int = 0) -> PlantSamples:
    how = PlantConfig(vehicle=VEHICLE, drone=drone, trajectory=trajectory, seed=seed, start="ground", landed_s=FLIGHT_S)
    return Plant(how).advance(round(FLIGHT_S * 1000))


def in_flight(samples: PlantSamples) -> slice:
    """From 14 s to 2 s before the motors stop, as the recordings are cut."""
    return slice(CUT_MS, int(np.flatnonzero(samples.motors == FLYING)[-1]) - 2000)


@pytest.mark.parametrize("drone", [1, 2, 3])
def test_gyro_bands_have_the_published_energy(drone: int) -> None:
    """Three flights of drone 1 in the mean, one of drones 2 and 3 each; within a factor 1.5 in every band."""
    published = np.sqrt(np.mean(np.square(PUBLISHED[drone]), axis=0))
    found = []
    for k in range(len(PUBLISHED[drone])):
        samples = flight("t2-sp1", drone, 740 + 10 * drone + k)
        f, power = welch(samples.gyro[in_flight(samples), 0], 1000.0, nperseg=1000)
        bands = ((50, 100), (100, 200), (200, 500))
        found.append(np.sqrt([power[(f >= low) & (f < high)].sum() * f[1] for low, high in bands]))
    ratio = np.sqrt(np.mean(np.square(found), axis=0)) / published
    assert np.all((ratio > 1 / 1.5) & (ratio < 1.5)), ratio


def test_rate_command_torque_and_duty_are_the_printed_formulas_of_the_recorded_signals() -> None:
    """12 (ref - angle) - .1 rate, yaw 2 ref; [.1876 .1544 .079] (cmd - rate) - [.0032 .0026 .010] accel."""
    samples, gains = flight("t2-sp1", 1, 750), make_controller(VEHICLE)
    assert (gains.yaw_rate, gains.trim, round(gains.tilt_limit, 4)) == (2.0, 14.754, round(math.pi / 4, 4))
    flown = in_flight(samples)
    angle, rate, acceleration = np.split(samples.attitude[flown], 3, axis=1)
    reference, command = samples.setpoint[flown, :2], samples.rate_setpoint[flown]
    np.testing.assert_allclose(command[:, :2], 12 * (reference - angle[:, :2]) - 0.1 * rate[:, :2], atol=1e-12)
    gain, brake, limit = np.array([[0.1876, 0.1544, 0.079], [0.0032, 0.0026, 0.010], [1.0915, 0.8984, 0.0984]])
    torque = np.clip(gain * (command - rate) - brake * acceleration, -limit, limit)
    thrust = samples.thrust_setpoint[flown, None] * 4 * gains.full_thrust
    # duty: F = .25 T -+ tau_x / 2 Lr ..., FRD; V from F = .03616 V^2 + .117 V - .01215; duty = V / V_bat.
    # motors 1 rear right, 2 front right, 3 rear left, 4 front left; nose up and turn right are positive
    roll, pitch, yaw = torque.T / [[2 * 0.254], [2 * 0.2032], [4 / 68.9055]]
    force = np.column_stack([-roll - pitch - yaw, -roll + pitch + yaw, roll - pitch + yaw, roll + pitch - yaw])
    volts = samples.duty[flown] * samples.battery_v[flown, None]
    lifted = 0.03616 * volts**2 + 0.117 * volts - 0.01215
    np.testing.assert_allclose(lifted, 0.25 * thrust + force, atol=1e-9)


@pytest.mark.parametrize("drone", [1, 3])
def test_yaw_cycles_at_24_hz_on_the_ground_with_a_saturated_torque_and_not_in_flight(drone: int) -> None:
    """Full-length lines of the recordings: 24.33, 24.43, 24.42, 24.10, 24.07 Hz, from 3.3 s to the take-off."""
    samples = flight("t3-sp1", drone, 760 + drone)
    yaw, standing, flown = samples.gyro[:, 2], slice(ARM_MS + 700, LIFT_MS - 500), in_flight(samples)
    f, power = welch(yaw[standing], 1000.0, nperseg=4096)
    assert 23.5 < f[1:][power[1:].argmax()] < 25.0
    torque = -0.079 * samples.attitude[standing, 5] - 0.010 * samples.attitude[standing, 8]
    assert np.mean(np.abs(torque) > 0.0984) > 0.5
    assert np.abs(samples.gyro[: ARM_MS - 100]).max() < 0.05
    f, power = welch(np.stack((yaw[standing], yaw[flown][:6000])), 1000, nperseg=2048)
    near = (f > 20.0) & (f < 28.0)
    assert power[0, near].sum() > 1000 * power[1, near].sum()


def test_the_motors_report_in_turn_and_too_much_and_the_gyro_has_the_steps_of_the_recordings() -> None:
    samples = flight("t1-sp2", 2, 732)
    np.testing.assert_allclose(samples.gyro / 1.3316e-4, np.rint(samples.gyro / 1.3316e-4), atol=1e-6)
    np.testing.assert_array_equal(samples.gyro[0::2], samples.gyro[1::2])
    assert [np.isnan(part).mean() for part in (samples.esc_speed[:990], samples.esc_speed[1040:])] == [1.0, 0.0]
    changed = np.diff(samples.esc_speed[CUT_MS:40_000], axis=0) != 0.0
    assert np.all(changed.sum(axis=1) <= 1)
    order = [int(np.flatnonzero(row)[0]) for row in changed if row.any()]
    assert order[:8] in [[(start - k) % 4 for k in range(8)] for start in range(4)]
    at = np.flatnonzero(changed[:, 2]) + CUT_MS + 1
    np.testing.assert_allclose(samples.esc_speed[at, 2], samples.rotor_speed[at, 2] * 14 / 12, rtol=1e-6)


N, SECONDS = 3000, 3.0  # of a square flown with a badly unbalanced rotor
EVERY_PROFILE = pytest.mark.parametrize("profile", list(PROFILES))
CONFIG = PlantConfig(fault="F1/SV3", rotor=2, seed=5, heading_rad=0.7)
LINKS = [("qdrone2", None), ("qdrone2", 250.0), ("spec", 1000.0), ("ardupilot", 50.0), ("px4", 160.0)]


@cache
def unbalanced() -> PlantSamples:
    return Plant(PlantConfig(fault="F1/SV3", rotor=2, seed=5)).advance(N)


def decoded(profile: str) -> list[Frame]:
    dialect, decoder, encode = DIALECTS[profile], Decoder(), Encoder(1, 1).encode_payload
    filtered = ImuFilters(dialect, seed=3).step(unbalanced().rows(0, N))
    due = messages_due(filtered, dialect.schedule(None), dialect)
    frames = [frame for one in due for frame in decoder.feed(encode(one.msgid, one.payload), one.t_ns)]
    (count,) = decoder.senders.values()
    damage = decoder.garbage_bytes, count.by_message.get(UNKNOWN, 0), count.lost, count.reordered, count.duplicated
    assert damage == (0, 0, 0, 0, 0)
    return frames


def values_of(frames: Sequence[Frame], msgid: int, *names: str) -> FloatArray:
    return np.array([[one.value(name) for name in names] for one in frames if one.msgid == msgid], float)


def test_an_esc_tells_its_speed_in_its_turn_in_steps_and_again_what_was_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """However the flight is cut."""
    monkeypatch.setattr("sitl_plant.autopilot.stream.ESC_LOST", 0.2)
    samples = unbalanced()
    whole = _EscFrames(5).step(samples.t_ns, samples.rotor_speed)
    cut, at = _EscFrames(5), [0, 7, 8, 250, N]
    parts = [cut.step(samples.t_ns[a:b], samples.rotor_speed[a:b]) for a, b in itertools.pairwise(at)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    step = 100 / 7 * np.pi / 30
    for rotor, told in enumerate(whole.T):
        changes = np.flatnonzero(np.diff(told, prepend=np.nan) != 0)
        changes = changes[np.isfinite(told[changes])][1:]  # the first one was told before
        np.testing.assert_allclose(told[changes], samples.rotor_speed[changes, rotor], atol=0.51 * step)
        phases = (samples.t_ns[changes] / 1e9 - 0.1 * rotor / 4) % 0.1
        assert np.minimum(phases, 0.1 - phases).max() < 0.0011
        np.testing.assert_allclose(told[changes] / step, np.rint(told[changes] / step), atol=1e-6)


@EVERY_PROFILE
def test_the_converter_reads_back_what_the_plant_measured(profile: str) -> None:
    heard, samples, table = telemetry_of(decoded(profile), profile), unbalanced(), PROFILES[profile]
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
    if not DIALECTS[profile].esc:
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
    heard, samples = telemetry_of(decoded("ardupilot"), "ardupilot"), unbalanced()
    (b, a), settled = butter(2, 20.0, fs=1000.0), 500  # the two filters start differently
    for signal, raw, unit in ((Signal.BODY_RATE, samples.gyro, 1e-3), (Signal.SPECIFIC_FORCE, samples.accel, 9.81e-3)):
        series = heard.need(signal)
        rows = (series.host_ns - int(samples.t_ns[0])) // 1_000_000
        expected, late = lfilter(b, a, raw - raw[0], axis=0) + raw[0], rows > settled
        np.testing.assert_allclose(series.values[late], expected[rows[late]], rtol=0, atol=0.55 * unit)


def test_the_vibration_level_is_ardupilots() -> None:
    """AP_InertialSensor::calc_vibration_and_clipping, sample by sample."""
    accel = unbalanced().accel
    floor, level, vibe, dt = accel[0].copy(), np.zeros(3), [], 1e-3
    alpha_floor, alpha_level = dt / (dt + 1 / (2 * np.pi * 5.0)), dt / (dt + 1 / (2 * np.pi * 2.0))
    for a in accel:
        floor += alpha_floor * (a - floor)
        level += alpha_level * ((a - floor) ** 2 - level)
        vibe.append(np.sqrt(level))
    sent = values_of(decoded("ardupilot"), MessageId.VIBRATION, "vibration_x", "vibration_y", "vibration_z")
    np.testing.assert_allclose(sent, np.array(vibe)[::100][: len(sent)], rtol=1e-3, atol=1e-9)
    assert sent[-1, 0] > 0.5  # m/s^2: the damaged rotor shakes


def test_what_is_above_15_5_g_in_any_axis_is_counted_as_clipped_and_12_cells_are_told() -> None:
    samples, dialect = unbalanced(), dialect_named("ardupilot")
    samples = replace(samples, accel=np.zeros_like(samples.accel), battery_v=np.full(N, 50.4))
    samples.accel[[5, 7, 9], [0, 1, 2]] = np.array([15.4, -15.6, 15.6]) * G
    sent = ImuFilters(dialect, 1).step(samples)
    assert sent.clippings[[6, 8, -1]].tolist() == [0, 1, 2]
    assert records(MessageId.SYS_STATUS, sent, np.array([0]), dialect)[1]["voltage_battery"] == 50_400


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
