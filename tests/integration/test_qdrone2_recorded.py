"""Flights of the QDrone 2 as it was recorded, against what is published of DronePropA.

The formulas are written out here once more, from the manufacturer's model, and filters are scipy's. No raw recording is
at hand. The vehicle's file was set to some of these figures (levels in 50-100 and 100-200 Hz, battery, thrust, hover
and over-reading, 24 Hz on the ground): there the tests hold what is made of the file, and are no evidence of
the model. Not set were the level in 200-500 Hz, the formulas, and that the trajectories are flown. Seeds are fresh.
"""

import math
from functools import lru_cache

import numpy as np
import pytest

from mavdiag.telemetry import FloatArray
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
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


@lru_cache(maxsize=2)  # a flight takes 80 MB
def flight(trajectory: str = "t2-sp1", drone: int = 1, seed: int = 0) -> PlantSamples:
    form = PlantConfig(
        vehicle=VEHICLE, drone=drone, trajectory=trajectory, seed=seed, start="ground", landed_s=FLIGHT_S
    )
    return Plant(form).advance(round(FLIGHT_S * 1000))


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


@pytest.mark.parametrize("drone", [1, 2, 3])
def test_gyro_bands_have_the_published_energy(drone: int) -> None:
    """Three flights of drone 1 in the mean, one of drones 2 and 3 each; within a factor 1.5 in every band."""
    published = np.sqrt(np.mean(np.square(PUBLISHED[drone]), axis=0))
    found = []
    for k in range(len(PUBLISHED[drone])):
        samples = flight("t2-sp1", drone, 740 + 10 * drone + k)
        log = samples.log
        found.append(bands(log["gyro"][in_flight(samples), 0, 0]))
    ratio = np.sqrt(np.mean(np.square(found), axis=0)) / published
    assert np.all((ratio > 1 / 1.5) & (ratio < 1.5)), ratio


def test_rate_command_torque_and_duty_are_the_printed_formulas_of_the_recorded_signals() -> None:
    """12 (ref - angle) - .1 rate, yaw 2 ref; [.1876 .1544 .079] (cmd - rate) - [.0032 .0026 .010] accel."""
    samples = flight("t2-sp1", 1, 750)
    log = samples.log
    flown = in_flight(samples)
    angle, rate, acceleration = (part[flown].mean(axis=1) for part in (log["angle"], log["rate"], log["acceleration"]))
    reference = np.clip(log["pid"][flown, :2], -math.pi / 4, math.pi / 4)
    command = np.column_stack([12 * (reference - angle[:, :2]) - 0.1 * rate[:, :2], 2 * log["pid"][flown, 3]])
    np.testing.assert_allclose(samples.rate_setpoint[flown], command, atol=1e-12)
    gain, brake = np.array([0.1876, 0.1544, 0.079]), np.array([0.0032, 0.0026, 0.010])
    torque = gain * (command - rate) - brake * acceleration
    np.testing.assert_allclose(log["torque_asked"][flown], torque, atol=1e-12)
    limit = [1.0915, 0.8984, 0.0984]
    np.testing.assert_allclose(log["torque"][flown], np.clip(torque, -np.array(limit), limit), atol=1e-12)
    np.testing.assert_allclose(log["thrust"][flown], 14.754 + log["pid"][flown, 2], atol=1e-9)
    # duty: F = .25 T -+ tau_x / 2 Lr ..., FRD; V from F = .03616 V^2 + .117 V - .01215; duty = V / V_bat.
    # motors 1 rear right, 2 front right, 3 rear left, 4 front left; nose up and turn right are positive
    roll, pitch, yaw = log["torque"][flown].T / [[2 * 0.254], [2 * 0.2032], [4 / 68.9055]]
    force = np.column_stack([-roll - pitch - yaw, -roll + pitch + yaw, roll - pitch + yaw, roll + pitch - yaw])
    volts = samples.duty[flown] * samples.battery_v[flown, None]
    lifted = 0.03616 * volts**2 + 0.117 * volts - 0.01215
    np.testing.assert_allclose(lifted, 0.25 * log["thrust"][flown, None] + force, atol=1e-9)


@pytest.mark.parametrize("drone", [1, 3])
def test_yaw_cycles_at_24_hz_on_the_ground_with_a_saturated_torque_and_not_in_flight(drone: int) -> None:
    """Full-length lines of the recordings: 24.33, 24.43, 24.42, 24.10, 24.07 Hz, from 3.3 s to the take-off."""
    samples = flight("t3-sp1", drone, 760 + drone)
    log = samples.log
    standing, flown = slice(ARM_MS + 700, LIFT_MS - 500), in_flight(samples)
    assert 23.5 < peak(log["gyro"][standing, 0, 2]) < 25.0
    assert np.mean(np.isclose(np.abs(log["torque"][standing, 2]), 0.0984)) > 0.5
    assert np.abs(log["gyro"][: ARM_MS - 100, 0]).max() < 0.05
    from scipy.signal import welch

    f, power = welch(
        np.column_stack([log["gyro"][standing, 0, 2], log["gyro"][flown, 0, 2][:6000]]).T, 1000, nperseg=2048
    )
    near = (f > 20.0) & (f < 28.0)
    assert power[0, near].sum() > 1000 * power[1, near].sum()


def test_the_motors_report_in_turn_and_too_much_and_the_gyro_has_the_steps_of_the_recordings() -> None:
    samples = flight("t1-sp2", 2, 732)
    log = samples.log
    np.testing.assert_allclose(log["gyro"] / 1.3316e-4, np.rint(log["gyro"] / 1.3316e-4), atol=1e-6)
    np.testing.assert_array_equal(samples.gyro, log["gyro"][:, 0])
    np.testing.assert_array_equal(log["gyro"][0::2], log["gyro"][1::2])
    assert np.all(np.isnan(samples.esc_speed[:990]))
    assert not np.any(np.isnan(samples.esc_speed[1040:]))
    changed = np.diff(samples.esc_speed[CUT_MS:40_000], axis=0) != 0.0
    assert np.all(changed.sum(axis=1) <= 1)
    order = [int(np.flatnonzero(row)[0]) for row in changed if row.any()]
    assert order[:8] in [[(start - k) % 4 for k in range(8)] for start in range(4)]
    at = np.flatnonzero(changed[:, 2]) + CUT_MS + 1
    np.testing.assert_allclose(samples.esc_speed[at, 2], samples.rotor_speed[at, 2] * 14 / 12, rtol=1e-6)
