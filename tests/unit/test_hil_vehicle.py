"""The table [hil] of the vehicle files: outputs in the autopilots' own order, and the files of parameters."""

from dataclasses import replace

import numpy as np
import pytest

from mavdiag.airframe.layout import layout_named
from mavdiag.errors import UsageError
from sitl_plant.hil.simulation import AutopilotName, output_map, parameter_file, pilot_of
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import Hil, HilPilot, allocation, qdrone2, vehicle_named

ARDUPILOT = {
    "qdrone2": "x",
    "qdrone2-recorded": "x",
    "quad-plus": "plus",
    "hexa-x": "hexa-x",
    "hexa-plus": "hexa-plus",
    "octo-x": "octo-x",
}


@pytest.mark.parametrize("name", ARDUPILOT)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_output_k_is_the_autopilots_motor_k(name: str, autopilot: AutopilotName) -> None:
    """What an output does to roll, pitch and yaw has the sign that ArduHilPilot's frame of that kind says."""
    vehicle = vehicle_named(name)
    outputs = pilot_of(vehicle, autopilot)[1].rotors
    effects = np.round(allocation(vehicle)[1:, np.array(outputs) - 1].T, 6)
    np.testing.assert_array_equal(np.sign(effects), np.sign(np.round(layout_named(ARDUPILOT[name]).mixing, 6)))


@pytest.mark.parametrize("name", ARDUPILOT)
def test_ardupilots_file_is_name_comma_value(name: str) -> None:
    vehicle = vehicle_named(name)
    lines = parameter_file(vehicle, "ardupilot").splitlines()
    assert lines[0].startswith("#")
    values = {line.split(",")[0]: float(line.split(",")[1]) for line in lines[1:]}
    assert values["FRAME_CLASS"] == {4: 1, 6: 2, 8: 3}[len(vehicle.rotors)]
    assert values["FRAME_TYPE"] == (0 if name.endswith("plus") else 1)
    hover = Plant(PlantConfig(vehicle=vehicle, drone=2, trajectory="hover")).advance(2000).duty
    assert values["MOT_THST_HOVER"] == pytest.approx(np.mean(hover**2), abs=0.015)
    assert all(len(parameter) <= 16 for parameter in values)


def test_px4s_file_has_the_tabs_of_qgroundcontrol_and_the_geometry() -> None:
    """Columns: vehicle, component, name, value, MAV_PARAM_TYPE (6 int32, 9 real32)."""
    rows = [line.split("\t") for line in parameter_file(qdrone2(), "px4").splitlines() if not line.startswith("#")]
    assert {(row[0], row[1]) for row in rows} == {("1", "1")}
    found = {name: (value, kind) for _, _, name, value, kind in rows}
    assert found["CA_ROTOR_COUNT"] == ("4", "6")
    assert found["CA_ROTOR0_PX"] == ("0.1016", "9")
    assert found["CA_ROTOR0_PY"] == ("0.127", "9")
    assert float(found["CA_ROTOR0_KM"][0]) == pytest.approx(1 / 68.9055, abs=1e-5), "front right, counter-clockwise"
    assert float(found["CA_ROTOR2_KM"][0]) < 0
    assert found["PWM_MAIN_FUNC4"] == ("104", "6")
    assert "SYS_HITL" not in found
    assert all(("." in value) == (kind == "9") for value, kind in found.values())


def test_a_vehicle_that_does_not_tell_its_outputs_is_refused() -> None:
    with pytest.raises(UsageError, match=r"add a table \[hil\]"):
        output_map(replace(qdrone2(), hil=None), "ardupilot")
    twice = HilPilot((1, 2, 3, 3))
    with pytest.raises(UsageError, match=r"hil.px4.rotors must name each rotor 1 to 4 once"):
        output_map(replace(qdrone2(), hil=Hil((1000.0, 2000.0), twice, twice)), "px4")
