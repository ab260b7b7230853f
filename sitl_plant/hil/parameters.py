"""The file of suggested parameters that a user loads into an autopilot."""

from collections.abc import Mapping

from sitl_plant.hil.outputs import AutopilotName, pilot_of
from sitl_plant.vehicle import Vehicle

FIRST_MOTOR = 101  # PX4's output function "Motor 1"
INT32, REAL32 = 6, 9  # MAV_PARAM_TYPE


def parameter_file(vehicle: Vehicle, autopilot: AutopilotName, *, hardware: bool = False) -> str:
    """ArduPilot: lines of NAME,VALUE (.param). PX4: the tabs of QGroundControl (.params).

    hardware: for a PX4 flight controller in HIL mode, not for PX4 in simulation.
    Raises UsageError if the vehicle's file has no parameters for it.
    """
    pilot = pilot_of(vehicle, autopilot)[1]
    head = f"# {vehicle.name} of sitl-plant: suggested for a simulation, not for a vehicle that flies\n"
    if autopilot == "ardupilot":
        return head + "".join(f"{name},{value}\n" for name, value in pilot.parameters.items())
    rows = {**pilot.parameters, **_geometry(vehicle, pilot.rotors), **_functions(len(pilot.rotors), hardware)}
    lines = (f"1\t1\t{name}\t{value}\t{INT32 if isinstance(value, int) else REAL32}\n" for name, value in rows.items())
    return head + "# Vehicle-Id Component-Id Name Value Type\n" + "".join(lines)


def _geometry(vehicle: Vehicle, rotors: tuple[int, ...]) -> Mapping[str, int | float]:
    """PX4's control allocation: where its motors are, and their moment over thrust, positive for counter-clockwise."""
    found: dict[str, int | float] = {"CA_ROTOR_COUNT": len(rotors)}
    for motor, number in enumerate(rotors):
        rotor = vehicle.rotors[number - 1]
        found |= {f"CA_ROTOR{motor}_P{axis}": place for axis, place in zip("XYZ", rotor.position_m, strict=True)}
        found[f"CA_ROTOR{motor}_KM"] = round(-rotor.sign / vehicle.propulsion.thrust_per_torque_1_m, 5)
    return found


def _functions(motors: int, hardware: bool) -> Mapping[str, int]:
    name = "HIL_ACT_FUNC" if hardware else "PWM_MAIN_FUNC"
    functions = {f"{name}{1 + motor}": FIRST_MOTOR + motor for motor in range(motors)}
    return {"SYS_HITL": 1, **functions} if hardware else functions
