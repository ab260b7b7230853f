"""ESC telemetry from the emulator to the daemon on a virtual clock."""

from dataclasses import replace
from pathlib import Path

import pytest
from made_vehicle import Bench
from virtual_flight import VirtualFlight, healthy_flights, learnt

from detector.config import Settings
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

VEHICLE = replace(qdrone2(), propulsion=replace(qdrone2().propulsion, load_share=0.2))


@pytest.mark.parametrize("profile", ["ardupilot", "px4"])
def test_esc_telemetry_is_learnt_from_metered_and_the_weak_rotor_is_named(profile: str) -> None:
    baseline = learnt(healthy_flights(range(3), 40.0, profile, vehicle=VEHICLE))
    assert "rotor_speed" in {entry.spec.kind for entry in baseline.monitors}
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json")), baseline=baseline)
    damage = Injection(RotorDamage(thrust_factor=0.9, drag_factor=0.9), rotor=3, onset_s=20.0)
    try:
        VirtualFlight(bench).fly(PlantConfig(seed=9, vehicle=VEHICLE, injections=(damage,)), 35.0, profile)
        (figures,) = bench.daemon.fleet.figures()
        lines = bench.host.lines
    finally:
        bench.close()
    assert any("PROP FAULT motor 3" in line for line in lines)
    assert dict(figures.rates)["rotor_speed"] == pytest.approx(10.0, rel=0.1)
    assert figures.diagnosis.rotor == 3
    ratios = {monitor: ratio for monitor, _, ratio in figures.ratios}
    assert ratios["rotor_speed"] > 1.0
    assert "rotor_trim" in ratios
