"""The monitors of sensors and losses, on flights made by equations: what they find, and what leaves them silent."""

import numpy as np
import pytest
from made_rows import example_rows, read
from made_telemetry import body_rates

from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.control_loss import ControlLoss, ControlLossSpec
from mavdiag.monitors.sensor_drift import SensorDrift, SensorDriftSpec
from mavdiag.monitors.sensor_noise import SensorNoise, SensorNoiseSpec
from mavdiag.monitors.thrust_loss import ThrustLoss, ThrustLossSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.units import G

DT_S, N = 0.01, 4000
AGREED = SensorDriftSpec(dt_s=DT_S, bias=(0.0, 0.0, 0.0), vertical=0.0, tilt=0.01, heading=0.01, lift=0.08)
QUIET = SensorNoiseSpec(rms=(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))


def attitude(yaw_rate: float = 0.0) -> FloatArray:
    """Roll and pitch swing by 0.1 rad, the heading turns."""
    t = DT_S * np.arange(N)
    return np.column_stack((0.1 * np.sin(0.9 * t), 0.1 * np.sin(0.7 * t + 1.0), yaw_rate * t))


def level_force(angle: FloatArray) -> FloatArray:
    """What an accelerometer reads that is not accelerated."""
    phi, theta, _ = angle.T
    return -G * np.column_stack((-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)))


def drift(angle: FloatArray, rate: FloatArray, force: FloatArray) -> Statistic:
    return read(SensorDrift(AGREED), example_rows(N, DT_S, rate=rate, force=force, attitude=angle))


@pytest.mark.parametrize("yaw_rate", [0.0, 0.5, -2.0])
def test_sensors_that_agree_are_silent_however_the_vehicle_turns(yaw_rate: float) -> None:
    angle = attitude(yaw_rate)
    assert drift(angle, body_rates(angle), level_force(angle)).value.max() < 1.0
    angle[:, 2] += 2.0 * np.sin(DT_S * np.arange(N))  # to and fro, and the attitude comes 30 ms late
    late = angle[np.maximum(np.arange(N) - 3, 0)]
    assert drift(late, body_rates(angle), level_force(late)).value.max() < SensorDrift.least
    for reset in ((0.07, -0.05, 0.1), (0.0, 0.0, 0.4), (0.0, 0.0, -2.5)):  # once, of an estimate that comes at 4 Hz
        seen = late + np.clip((np.arange(N) - 2000) / 25, 0.0, 1.0)[:, None] * reset
        assert drift(seen, body_rates(angle), level_force(seen)).value.max() < SensorDrift.least
    assert drift(late, body_rates(angle) * (1.0, 1.0, 0.0), level_force(late)).value.max() > SensorDrift.least


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_gyro_that_drifts_grows_by_its_integral(axis: int) -> None:
    angle = attitude()
    found = drift(angle, body_rates(angle) + 0.01 * np.eye(3)[axis], level_force(angle))
    for tick, span_s in ((399, 15.0), (79, 6.0)):  # after 8 s there are 6 s between the two means of 2 s
        excused = (0.0041 if axis == 2 else 0.004) * span_s  # a bias that is no fault, and 1 % of what the gyro turns
        assert found.value[tick] == pytest.approx(0.01 * span_s / (0.01 + excused), rel=0.1)


def test_a_vertical_bias_counts_only_where_it_lasts() -> None:
    angle = attitude()
    lasting, short = level_force(angle), level_force(angle)
    lasting[1000:, 2] += 0.4
    short[1000:1200, 2] -= 2.0  # a climb that begins: 4 m/s more
    assert drift(angle, body_rates(angle), lasting).value[-1] == pytest.approx(0.4 / 0.08, rel=0.05)
    assert drift(angle, body_rates(angle), short).value.max() < SensorDrift.least


def noise(rng: np.random.Generator, *loud: tuple[int, float]) -> Statistic:
    """White noise on six axes, some of them louder."""
    x = rng.normal(0.0, 1.0 / np.sqrt(70.0), (N, 6))  # 70: sum of squares of the fourth difference
    for axis, times in loud:
        x[N // 2 :, axis] *= times
    return read(SensorNoise(QUIET), example_rows(N, 0.001, rate=x[:, :3], force=x[:, 3:]))


@pytest.mark.parametrize("axis", range(6))
def test_noise_of_one_axis_is_found_and_shaking_of_several_is_not(axis: int) -> None:
    rng = np.random.default_rng(axis)
    alone = noise(rng, (axis, 5.0))
    assert alone.value[: N // 2].max() < 1.0 < 1.5 < alone.value[-1]
    assert noise(rng, (axis, 5.0), ((axis + 1) % 6, 3.0)).value.max() < 1.5


def test_only_a_turn_that_nobody_commanded_is_a_loss_of_control() -> None:
    none, rate, turning, jump = np.zeros((4, N, 3))
    rate[1000:1400, 0], jump[1000:, 2] = 10.0, 1.5
    turning[1000:, 0] = 10.0 * DT_S * np.minimum(np.arange(N - 1000), 399)
    cases = {"upset": (rate, none, 10.0), "commanded": (rate, turning, 0.1), "set-point that jumps": (none, jump, 0.1)}
    for name, (measured, setpoint, value) in cases.items():
        found = read(ControlLoss(ControlLossSpec()), example_rows(N, DT_S, rate=measured, setpoint=setpoint))
        inside = slice(1010, 1390)  # the rate filters see the edges
        assert float(np.median(found.value[inside])) == pytest.approx(value, abs=0.2), name


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_rotor_that_is_gone_is_named_by_how_the_vehicle_falls(rotor: int) -> None:
    layout = layout_named("qdrone2")
    force, rate = np.tile([0.0, 0.0, -G], (N, 1)), np.zeros((N, 3))
    force[2000:, 2] *= 0.6
    rate[2000:, :2] = -5.0 * layout.mixing[rotor - 1, :2]
    monitor = ThrustLoss(ThrustLossSpec(layout=layout, per_command=2 * G))
    found = read(monitor, example_rows(N, DT_S, rate=rate, force=force, thrust=np.full(N, 0.5)))
    assert found.value[:2000].max() < 0.01
    assert (found.value[2015], int(found.rotors[2015].argmax()) + 1) == (pytest.approx(0.4, abs=0.05), rotor)


def test_less_thrust_by_command_battery_or_payload_is_no_loss() -> None:
    t = DT_S * np.arange(N)
    thrust, battery = 0.5 + 0.1 * np.sin(t), 1.0 - 0.3 * t / t[-1]
    force = np.column_stack((np.zeros((N, 2)), -2 * G * battery * thrust))
    rate = np.full((N, 3), 3.0)
    monitor = ThrustLoss(ThrustLossSpec(layout=None, per_command=2 * G))
    found = read(monitor, example_rows(N, DT_S, rate=rate, force=force, thrust=thrust))
    assert found.value.max() < 0.1
    assert found.rotors.shape == (N, 0)
