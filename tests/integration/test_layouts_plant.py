"""The rotor layout of emulated vehicles under strong vibration, from their outputs alone, on a fast and a slow link."""

import pytest

pytest.importorskip("numba", reason="the plant is an extra")

from mavdiag.airframe.detect import detect_layout
from mavdiag.learning import front_for, rows_of
from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import vehicle_named

SHAKEN_G_MM = 10.0  # of every rotor; the worst damaged propeller of T Table 3.2 has 5.5


@pytest.mark.parametrize("link", [LinkSpec("qdrone2"), LinkSpec("ardupilot", 100.0)], ids=["1 kHz", "100 Hz"])
@pytest.mark.parametrize(
    ("vehicle", "layout"),
    [
        ("qdrone2", "qdrone2"),
        ("quad-plus", "plus"),
        ("hexa-x", "hexa-x"),
        ("hexa-plus", "hexa-plus"),
        ("octo-x", "octo-x"),
    ],
)
def test_the_layout_of_a_shaken_vehicle_is_found(vehicle: str, layout: str, link: LinkSpec) -> None:
    kind = vehicle_named(vehicle)
    shaken = tuple(Injection(RotorDamage(unbalance_g_mm=SHAKEN_G_MM), n + 1) for n in range(len(kind.rotors)))
    config = PlantConfig(drone=1, vehicle=kind, seed=611, wind_m_s=1.0, injections=shaken)
    telemetry, flown_s = flight_telemetry(config, 15.0, link)
    assert flown_s == pytest.approx(15.0)
    log = Log(vehicle, "", link.profile, telemetry)
    found = detect_layout(rows.block for rows in rows_of(front_for([log], 0.1), log.telemetry))
    assert found.layout is not None, found.reason
    assert found.layout.name == layout
    assert found.outputs == tuple(range(1, len(kind.rotors) + 1))
