"""Flights of the QDrone 2 as it was recorded, against what is published of DronePropA.

The formulas are written out here once more, from the manufacturer's model, and filters are scipy's. No raw recording is
at hand. The vehicle's file was set to some of these figures (levels in 50-100 and 100-200 Hz, battery, thrust, hover
and over-reading, 24 Hz on the ground): there the tests hold what is made of the file, and are no evidence of
the model. Not set were the level in 200-500 Hz, the formulas, and that the trajectories are flown. Seeds are fresh.
"""

import hashlib
import math
from dataclasses import fields
from functools import lru_cache

import numpy as np
import pytest

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, Signal
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.physics.airframe import draw_airframe
from sitl_plant.physics.trajectory import Shape
from sitl_plant.plant import Plant, PlantConfig, PlantSamples, RecordedLog
from sitl_plant.vehicle import vehicle_named

VEHICLE = vehicle_named("qdrone2-recorded")
FLIGHT_S = 88.0  # as F0_SV0_SP1_t1_D1_R1
ARM_MS, LIFT_MS, CUT_MS = 3300, 10500, 14000  # of its timeline; the first 14 s are cut
FLYING = 2
PUBLISHED = {  # roll gyro, rad/s rms in 50-100, 100-200, 200-500 Hz
    1: ((0.0123, 0.0398, 0.0203), (0.0120, 0.0310, 0.0158), (0.0124, 0.0312, 0.0159)),
    2: ((0.0140, 0.0192, 0.0105),),
    3: ((0.0125, 0.0179, 0.0097),),
}
RECORDED = [str(shape) for shape in Shape if shape.recorded]


@lru_cache(maxsize=2)  # a flight takes 80 MB
def flight(trajectory: str = "t2-sp1", drone: int = 1, seed: int = 0) -> tuple[PlantSamples, RecordedLog]:
    """A whole flight from the ground to the ground."""
    form = PlantConfig(
        vehicle=VEHICLE, drone=drone, trajectory=trajectory, seed=seed, start="ground", landed_s=FLIGHT_S
    )
    samples = Plant(form).advance(round(FLIGHT_S * 1000))
    return samples, RecordedLog.of(samples.log)


def in_flight(samples: PlantSamples) -> slice:
    """From 14 s to 2 s before the motors stop, as the recordings are cut."""
    return slice(CUT_MS, int(np.flatnonzero(samples.motors == FLYING)[-1]) - 2000)


def bands(signal: FloatArray) -> FloatArray:
    from scipy.signal import welch

    f, power = welch(signal, 1000.0, nperseg=1000)
    edges = ((50, 100), (100, 200), (200, 500))
    return np.sqrt([power[(f >= low) & (f < high)].sum() * f[1] for low, high in edges])


def peak(signal: FloatArray, above_hz: float = 0.0, nperseg: int = 4096) -> float:
    from scipy.signal import welch

    f, power = welch(signal, 1000.0, nperseg=nperseg)
    return float(f[f > above_hz][power[f > above_hz].argmax()])


@pytest.mark.parametrize("trajectory", RECORDED)
def test_it_flies_every_trajectory_within_its_limits_and_lands(trajectory: str) -> None:
    drone = 1 + RECORDED.index(trajectory) % 3
    samples, log = flight(trajectory, drone, 700 + RECORDED.index(trajectory))
    air = np.flatnonzero(samples.motors == FLYING)
    assert air[0] == LIFT_MS
    assert samples.motors[-1] == 0
    assert abs(samples.position[-1, 2]) < 0.02
    assert np.abs(log.pid[air, :2]).max() < math.pi / 4
    assert np.abs(samples.rate_setpoint[air]).max() < 10 * math.pi / 3
    assert samples.duty.max() < 1.0
    flown = in_flight(samples)
    assert np.abs(log.gyro[flown]).max() < 4.36
    assert np.all(np.abs(log.torque[flown]) < [1.0915, 0.8984, 0.0984])
    assert samples.position[flown, 2].max() < -0.1  # t3 and t4 go down to 0.2 m
    error = log.pose - log.desired  # just before each new set-point
    arrived = [t for t in range(CUT_MS, flown.stop) if np.any(log.desired[t + 1] != log.desired[t])]
    dwelt = [t for t in arrived if np.all(log.desired[t - 1000] == log.desired[t])]
    assert len(dwelt) >= 5
    assert np.abs(error[dwelt, :3]).max() < 0.15
    assert np.abs(np.angle(np.exp(1j * error[dwelt, 3]))).max() < 0.15


@pytest.mark.parametrize("drone", [1, 2, 3])
def test_battery_thrust_and_telemetry_are_those_of_the_recordings(drone: int) -> None:
    """16.0 V idle, 15.3 to 14.8 V in flight; about 13.1 N; reported speed .545 x 15 V x 1300 / 60 = 177 Hz."""
    samples, log = flight("t1-sp1", drone, 720 + drone)
    flown = in_flight(samples)
    assert samples.battery_v[1000] == pytest.approx(16.0, abs=0.1)
    assert samples.battery_v[flown.start] == pytest.approx(15.3, abs=0.15)
    assert samples.battery_v[flown.stop] == pytest.approx(14.8, abs=0.15)
    assert log.thrust[flown].mean() == pytest.approx(13.1, abs=0.4)
    assert -1.9 < log.pid[flown, 2].mean() < -1.2
    assert np.nanmean(log.esc[flown]) / (2 * math.pi) == pytest.approx(177.0, rel=0.03)


@pytest.mark.parametrize(("drone", "harmonic"), [(1, 1), (2, 1), (3, 2)])
def test_the_hover_line_is_at_150_hz_and_drone_3_is_ruled_by_the_second(drone: int, harmonic: int) -> None:
    """115 of 130 flights peak at 148.4 or 152.3 Hz, the second line is at 303.8, on drone 3 at 308 Hz."""
    samples, log = flight("t1-sp2", drone, 730 + drone)
    flown = in_flight(samples)
    assert 148.0 < peak(log.gyro[flown, 0, 0], 50.0) < 154.0
    assert 148.0 * harmonic < peak(log.accel[flown, 0, 2], 50.0) < 154.0 * harmonic


@pytest.mark.parametrize("drone", [1, 2, 3])
def test_gyro_bands_have_the_published_energy(drone: int) -> None:
    """Three flights of drone 1 in the mean, one of drones 2 and 3 each; within a factor 1.5 in every band."""
    published = np.sqrt(np.mean(np.square(PUBLISHED[drone]), axis=0))
    found = []
    for k in range(len(PUBLISHED[drone])):
        samples, log = flight("t2-sp1", drone, 740 + 10 * drone + k)
        found.append(bands(log.gyro[in_flight(samples), 0, 0]))
    ratio = np.sqrt(np.mean(np.square(found), axis=0)) / published
    assert np.all((ratio > 1 / 1.5) & (ratio < 1.5)), ratio


def test_drawn_specimens_spread_twofold_and_stay_near_the_measured_range() -> None:
    """Roll gyro, 100 to 200 Hz: .018 to .040 rad/s among healthy drones."""
    rng, levels = np.random.default_rng(77), []
    for k in range(12):
        airframe = draw_airframe(VEHICLE, aged=False, rng=rng, name=f"airframe {k}")
        samples = Plant(PlantConfig(airframe=airframe, trajectory="hover", seed=k)).advance(4000)
        levels.append(bands(RecordedLog.of(samples.log).gyro[:, 0, 0])[1])
    assert min(levels) > 0.018 / 1.5
    assert max(levels) < 0.040 * 1.5
    assert max(levels) / min(levels) > 1.7


def test_the_second_imu_shakes_more_on_the_same_body_and_both_have_the_steps_of_the_recordings() -> None:
    samples, log = flight("t1-sp1", 1, 721)
    first, second = (bands(log.gyro[in_flight(samples), k, 0])[1] for k in (0, 1))
    assert second / first == pytest.approx(2.2, rel=0.15)
    counts = log.gyro / 1.3316e-4
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    np.testing.assert_array_equal(samples.gyro, log.gyro[:, 0])
    np.testing.assert_array_equal(log.gyro[0::2], log.gyro[1::2])


def test_filtered_rates_are_the_second_order_filter_of_the_raw_gyro() -> None:
    """wn 120 rad/s, zeta 1, and its derivative state, both by scipy."""
    from scipy.signal import cont2discrete, dlsim

    samples, log = flight("t1-sp1", 2, 722)
    flown = in_flight(samples)
    A, B = np.array([[0.0, 1.0], [-(120.0**2), -240.0]]), np.array([[0.0], [120.0**2]])
    a, b, _, _, _ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), 0.001)
    for k in (0, 1):
        raw = log.gyro[flown, k, 0]
        _, states, _ = dlsim((a, b, np.eye(2), np.zeros((2, 1)), 0.001), raw[:, None])
        np.testing.assert_allclose(log.rate[flown, k, 0][1000:-1], states[1001:, 0], atol=1e-9)
        np.testing.assert_allclose(log.acceleration[flown, k, 0][1000:-1], states[1001:, 1], atol=1e-7)


def test_rate_command_torque_and_duty_are_the_printed_formulas_of_the_recorded_signals() -> None:
    """12 (ref - angle) - .1 rate, yaw 2 ref; [.1876 .1544 .079] (cmd - rate) - [.0032 .0026 .010] accel."""
    samples, log = flight("t2-sp1", 1, 750)
    flown = in_flight(samples)
    angle, rate, acceleration = (part[flown].mean(axis=1) for part in (log.angle, log.rate, log.acceleration))
    reference = np.clip(log.pid[flown, :2], -math.pi / 4, math.pi / 4)
    command = np.column_stack([12 * (reference - angle[:, :2]) - 0.1 * rate[:, :2], 2 * log.pid[flown, 3]])
    np.testing.assert_allclose(samples.rate_setpoint[flown], command, atol=1e-12)
    gain, brake = np.array([0.1876, 0.1544, 0.079]), np.array([0.0032, 0.0026, 0.010])
    torque = gain * (command - rate) - brake * acceleration
    np.testing.assert_allclose(log.torque_asked[flown], torque, atol=1e-12)
    limit = [1.0915, 0.8984, 0.0984]
    np.testing.assert_allclose(log.torque[flown], np.clip(torque, -np.array(limit), limit), atol=1e-12)
    np.testing.assert_allclose(log.thrust[flown], 14.754 + log.pid[flown, 2], atol=1e-9)
    # duty: F = .25 T -+ tau_x / 2 Lr ..., FRD; V from F = .03616 V^2 + .117 V - .01215; duty = V / V_bat.
    # motors 1 rear right, 2 front right, 3 rear left, 4 front left; nose up and turn right are positive
    roll, pitch, yaw = log.torque[flown].T / [[2 * 0.254], [2 * 0.2032], [4 / 68.9055]]
    force = np.column_stack([-roll - pitch - yaw, -roll + pitch + yaw, roll - pitch + yaw, roll + pitch - yaw])
    volts = samples.duty[flown] * samples.battery_v[flown, None]
    lifted = 0.03616 * volts**2 + 0.117 * volts - 0.01215
    np.testing.assert_allclose(lifted, 0.25 * log.thrust[flown, None] + force, atol=1e-9)


@pytest.mark.parametrize("drone", [1, 3])
def test_yaw_cycles_at_24_hz_on_the_ground_with_a_saturated_torque_and_not_in_flight(drone: int) -> None:
    """Full-length lines of the recordings: 24.33, 24.43, 24.42, 24.10, 24.07 Hz, from 3.3 s to the take-off."""
    samples, log = flight("t3-sp1", drone, 760 + drone)
    standing, flown = slice(ARM_MS + 700, LIFT_MS - 500), in_flight(samples)
    assert 23.5 < peak(log.gyro[standing, 0, 2]) < 25.0
    assert np.mean(np.isclose(np.abs(log.torque[standing, 2]), 0.0984)) > 0.5
    assert np.abs(log.gyro[: ARM_MS - 100, 0]).max() < 0.05
    from scipy.signal import welch

    f, power = welch(np.column_stack([log.gyro[standing, 0, 2], log.gyro[flown, 0, 2][:6000]]).T, 1000, nperseg=2048)
    near = (f > 20.0) & (f < 28.0)
    assert power[0, near].sum() > 1000 * power[1, near].sum()


def test_the_motors_report_in_turn_and_too_much() -> None:
    samples, log = flight("t1-sp2", 2, 732)
    assert np.all(np.isnan(log.esc[:990]))
    assert not np.any(np.isnan(log.esc[1040:]))
    changed = np.diff(log.esc[CUT_MS:40_000], axis=0) != 0.0
    assert np.all(changed.sum(axis=1) <= 1)
    order = [int(np.flatnonzero(row)[0]) for row in changed if row.any()]
    assert order[:8] in [[(start - k) % 4 for k in range(8)] for start in range(4)]
    at = np.flatnonzero(changed[:, 2]) + CUT_MS + 1
    np.testing.assert_allclose(log.esc[at, 2], samples.rotor_speed[at, 2] * 14 / 12, rtol=1e-6)


def test_equal_seeds_give_equal_bits_however_the_flight_is_cut() -> None:
    config = PlantConfig(vehicle=VEHICLE, trajectory="t5-sp1", fault="F2/SV2", onset_s=1.2, seed=79, start="ground")

    def digest(cuts: tuple[int, ...], seed: int = 79) -> str:
        from dataclasses import replace

        plant, whole = Plant(replace(config, seed=seed)), hashlib.sha256()
        parts = [plant.advance(n) for n in cuts]
        for column in fields(PlantSamples):
            whole.update(np.concatenate([getattr(part, column.name) for part in parts]).tobytes())
        return whole.hexdigest()

    assert digest((6000,)) == digest((1, 999, 4003, 997))
    assert digest((6000,)) != digest((6000,), seed=80)


def test_driving_with_the_duties_of_a_flight_flies_it_again() -> None:
    """The delay of the motors and the telemetry go on with commands from outside."""
    config = PlantConfig(vehicle=VEHICLE, trajectory="t4-sp1", seed=83)
    flown, plant = Plant(config).advance(3000), Plant(config)
    driven = [plant.drive(flown.duty[first:end], end - first) for first, end in ((0, 7), (7, 1500), (1500, 3000))]
    for name in ("gyro", "accel", "attitude", "position", "rotor_speed", "esc_speed"):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in driven]), getattr(flown, name))


def test_a_link_carries_the_telemetry_of_the_motors_as_it_is() -> None:
    config = PlantConfig(vehicle=VEHICLE, trajectory="hover", seed=81)
    samples = Plant(config).advance(3000)
    telemetry, _ = flight_telemetry(config, 3.0, LinkSpec("qdrone2", 200.0))
    heard = next(one for one in telemetry.series if one.signal is Signal.ROTOR_SPEED)
    rows = heard.t_ns // 1_000_000
    np.testing.assert_allclose(heard.values[:, :4], samples.esc_speed[rows], atol=0.06)
    assert np.mean(heard.values[:, :4] / samples.rotor_speed[rows]) == pytest.approx(14 / 12, rel=1e-3)


def test_the_thesiss_vehicle_keeps_no_such_log_and_can_fly_the_recorded_paths_too() -> None:
    samples = Plant(PlantConfig(trajectory="t1-sp2", seed=82)).advance(30_000)
    np.testing.assert_array_equal(samples.esc_speed, samples.rotor_speed)
    np.testing.assert_allclose(samples.position[9900, :2], [1, 1], atol=0.1)
    np.testing.assert_allclose(samples.position[19_900, :2], [-1, -1], atol=0.1)
    with pytest.raises(UsageError, match="qdrone2-recorded"):
        RecordedLog.of(samples.log)
