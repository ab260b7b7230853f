"""What is changed in flight: causes, wind, battery; and what the truth file says of it."""

import json
from typing import Any

import numpy as np
import pytest
from weak_rotor import sparing

from mavdiag.errors import UsageError
from sitl_plant.physics.airframe import drone
from sitl_plant.physics.faults import Injection, RotorDamage, SensorFault, fault_injection
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.truth import Truth
from sitl_plant.vehicle import vehicle_named

HOVER = PlantConfig(trajectory="hover", seed=4)


def test_injected_in_flight_is_as_configured_before_it() -> None:
    cause = Injection(RotorDamage(0.9, 1.2), rotor=2, onset_s=0.5, angle_rad=1.0)
    configured = Plant(PlantConfig(trajectory="hover", seed=4, injections=(cause,))).advance(800)
    plant = Plant(HOVER)
    before = plant.advance(500)
    plant.inject(cause)
    after = plant.advance(300)
    np.testing.assert_array_equal(np.vstack([before.gyro, after.gyro]), configured.gyro)


@pytest.mark.parametrize("name", ["qdrone2", "qdrone2-recorded"])
def test_cleared_is_healthy_again(name: str) -> None:
    """A hover with one rotor at 0.85 takes a higher duty there; cleared, all are alike again, and the gyro reads 0."""
    vehicle = vehicle_named(name)
    plant = Plant(PlantConfig(trajectory="hover", vehicle=vehicle, fault="F1/SV1", rotor=4, seed=1))
    plant.inject(Injection(RotorDamage(0.85), rotor=2))
    plant.inject(Injection(SensorFault("gyro", 2, drift_per_s=0.01)))
    weak = plant.advance(6000).duty[-2000:].mean(axis=0)
    plant.clear()
    whole = plant.advance(8000)
    healthy = Plant(PlantConfig(trajectory="hover", vehicle=vehicle, seed=1)).advance(8000)
    duty = healthy.duty[-2000:].mean(axis=0)
    assert weak[1] / duty[1] > 1.05
    np.testing.assert_allclose(whole.duty[-2000:].mean(axis=0), duty, rtol=0.01)
    assert whole.gyro[-2000:, 2].mean() == pytest.approx(healthy.gyro[-2000:, 2].mean(), abs=0.005)


@pytest.mark.parametrize(
    ("injection", "says"),
    [(Injection(RotorDamage(0.9), 9), "rotor must be 1 to 4"), (Injection(RotorDamage(0.9), 1, 0.0, 0.1), "end_s")],
)
def test_what_cannot_be_injected_is_refused_and_not_noted(injection: Injection, says: str) -> None:
    plant = Plant(HOVER)
    plant.advance(200)
    with pytest.raises(UsageError, match=says):
        plant.inject(injection)
    assert plant.take_changes() == ()


def test_the_truth_has_every_change_with_its_time() -> None:
    plant = Plant(PlantConfig(trajectory="hover", airframe=drone(vehicle_named("qdrone2"), 2), seed=4))
    truth, lines = Truth(plant.config, "qdrone2", 1000.0, 10**18), []
    plant.advance(500)
    plant.inject(fault_injection("F2/SV2", 3, onset_s=0.75))
    plant.inject(Injection(SensorFault("accel", 1, offset=0.2)))
    plant.set_wind(2.0, 1.0)
    lines += truth.step(plant.advance(600), plant.take_changes())
    plant.clear()
    plant.renew_battery()
    lines += truth.step(plant.advance(1000), plant.take_changes())
    found = [json.loads(line) for line in lines]
    told = [(one["record"], one["t_s"], one.get("fault"), one.get("rotor")) for one in found]
    assert told == [
        ("wind", 0.5, None, None),
        ("onset", 0.5, None, None),
        ("onset", 0.75, "F2/SV2", 3),
        ("state", 1.0, None, None),
        ("clear", 1.1, None, None),
        ("battery", 1.1, None, None),
        ("state", 2.0, None, None),
    ]
    assert [one["fault_present"] for one in found if one["record"] == "state"] == [True, False]
    assert found[1]["cause"]["sensor"] == "accel"
    assert found[0]["wind_m_s"] == 2.0
    assert found[2]["unix_ns"] == 10**18 + 750_000_000


def _weak(vehicle: str, way: dict[str, Any], allocation: tuple[float, float] | None) -> tuple[float, float, float]:
    """Tilt error [rad], mean and highest duty of rotor 2, which has lost a fifth of its thrust."""
    lost = Injection(RotorDamage(thrust_factor=0.8), 2, 1.0)
    plant = Plant(PlantConfig(drone=3, vehicle=vehicle_named(vehicle), wind_m_s=1.0, injections=(lost,), **way))
    plant.advance(1000)
    if allocation is not None:
        plant.take_controller(sparing(plant.config.vehicle, 2, *allocation))
    plant.advance(3000)
    flown = plant.advance(8000)
    tilt = (flown.setpoint - flown.attitude[:, :3])[:, :2]
    return float(np.sqrt(np.mean(tilt**2))), float(flown.duty[:, 1].mean()), float(flown.duty[:, 1].max())


def test_an_allocation_for_a_weak_rotor_tilts_less_and_asks_less_of_it() -> None:
    square = {"speed_m_s": 1.5, "size_m": 3.0}
    tilt, _, most = _weak("qdrone2", square, None)
    spared, _, least = _weak("qdrone2", square, (0.8, 2.0))
    assert spared < 0.95 * tilt
    assert least < most
    hover, _, _ = _weak("qdrone2", {"trajectory": "hover"}, None)
    assert _weak("qdrone2", {"trajectory": "hover"}, (0.8, 2.0))[0] < 0.5 * hover
    _, mean, _ = _weak("hexa-x", {"trajectory": "hover"}, None)
    assert _weak("hexa-x", {"trajectory": "hover"}, (0.8, 2.0))[1] < 0.9 * mean  # the others take its load
