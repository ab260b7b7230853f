"""The rotor layout from the autopilot's own parameters: what its mixer is set to do, and on which outputs.

ArduPilot: FRAME_CLASS and FRAME_TYPE name a table of motors (AP_MotorsMatrix.cpp, setup_quad_matrix,
setup_hexa_matrix, setup_octa_matrix); SERVOn_FUNCTION 33 to 40 puts motor 1 to 8 on output n (82 to 85: motor 9 to 12).
PX4: CA_ROTOR_COUNT, and for rotor n from 0 its place CA_ROTORn_PX, _PY [m] (FRD: forward, right) and its moment
coefficient CA_ROTORn_KM, "positive for a rotor with CCW rotation" (control_allocator/module.yaml) seen from above,
which turns the nose to the right; <group>_FUNCn 101 to 112 puts motor 1 to 12 on output n of that group.

Only what can be stated with certainty is: tables on a circle, rotors of one kind that push up.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavdiag.airframe.layout import LAYOUTS, RotorLayout, layout_named, layout_of_effects, ring
from mavdiag.errors import UsageError

__all__ = ["ParameterFinding", "layout_from_parameters"]

_COPTER_MOTORS = (33, 34, 35, 36, 37, 38, 39, 40, 82, 83, 84, 85)  # SERVOn_FUNCTION of motor 1, 2, ...
_PX4_MOTOR_1, _PX4_MOTORS = 101, 12
_SERVO = re.compile(r"SERVO(\d+)_FUNCTION")
_PX4_FUNCTION = re.compile(r"(PWM_MAIN|PWM_AUX|HIL_ACT|UAVCAN_EC)_FUNC(\d+)")
_AIRFRAME_MULTIROTOR = 0  # CA_AIRFRAME
_UP = (0.0, 0.0, -1.0)  # CA_ROTORn_AX, _AY, _AZ by default
_SAME = 1e-3  # of an axis or of the thrust coefficients: closer ones are the same (our choice)

# FRAME_CLASS: its name and number of motors. FRAME_TYPE by class.
_CLASSES = {1: ("quad", 4), 2: ("hexa", 6), 3: ("octa", 8)}
_FRAMES: Mapping[tuple[int, int], RotorLayout] = {
    (1, 0): layout_named("plus"),
    (1, 1): layout_named("x"),
    (1, 3): ring("h", 45, -135, -45, 135, cw=(1, 2)),
    (1, 6): ring("plus-reversed", 90, -90, 0, 180, cw=(1, 2)),
    (1, 12): ring("x-betaflight", 135, 45, -135, -45, cw=(1, 4)),
    (1, 13): ring("x-dji", 45, -45, -135, 135, cw=(2, 4)),
    (1, 14): ring("x-clockwise", 45, 135, -135, -45, cw=(2, 4)),
    (1, 18): ring("x-betaflight-reversed", 135, 45, -135, -45, cw=(2, 3)),
    (2, 0): layout_named("hexa-plus"),
    (2, 1): layout_named("hexa-x"),
    (2, 13): ring("hexa-x-dji", 30, -30, -90, -150, 150, 90, cw=(2, 4, 6)),
    (2, 14): ring("hexa-x-clockwise", 30, 90, 150, -150, -90, -30, cw=(2, 4, 6)),
    (3, 0): layout_named("octo-plus"),
    (3, 1): layout_named("octo-x"),
    (3, 13): ring("octo-x-dji", 22.5, -22.5, -67.5, -112.5, -157.5, 157.5, 112.5, 67.5, cw=(2, 4, 6, 8)),
    (3, 14): ring("octo-x-clockwise", 22.5, 67.5, 112.5, 157.5, -157.5, -112.5, -67.5, -22.5, cw=(2, 4, 6, 8)),
}


@dataclass(frozen=True, slots=True)
class ParameterFinding:
    """What the parameters say of the rotors.

    layout: None if they do not say it, or contradict themselves.
    outputs: the output, from 1, of motor 1, 2, ...; None likewise.
    reason: what both rest on, or why one is not known; empty if the parameters say nothing of rotors.
    """

    layout: RotorLayout | None = None
    outputs: tuple[int, ...] | None = None
    reason: str = ""


def layout_from_parameters(parameters: Mapping[str, float]) -> ParameterFinding:
    """What an autopilot's parameters say of its rotors. parameters: by name; integers as floats.

    >>> layout_from_parameters({"FRAME_CLASS": 1, "FRAME_TYPE": 0}).layout.name
    'plus'
    >>> layout_from_parameters({"FRAME_CLASS": 1}).reason
    'FRAME_TYPE is not among the parameters'
    """
    px4, copter = "CA_ROTOR_COUNT" in parameters, "FRAME_CLASS" in parameters
    if px4 and copter:
        return ParameterFinding(reason="the parameters are of two autopilots (FRAME_CLASS and CA_ROTOR_COUNT)")
    if px4:
        return _px4(parameters)
    layout, reason = _copter_layout(parameters) if copter else (None, "")
    servos = {int(found[1]): value for name, value in parameters.items() if (found := _SERVO.fullmatch(name))}
    motors = {number: _COPTER_MOTORS.index(int(v)) + 1 for number, v in servos.items() if v in _COPTER_MOTORS}
    return _with_outputs(layout, reason, motors, "SERVOn_FUNCTION")


def _copter_layout(parameters: Mapping[str, float]) -> tuple[RotorLayout | None, str]:
    if "FRAME_TYPE" not in parameters:
        return None, "FRAME_TYPE is not among the parameters"
    frame = int(parameters["FRAME_CLASS"]), int(parameters["FRAME_TYPE"])
    told = f"FRAME_CLASS {frame[0]}, FRAME_TYPE {frame[1]}"
    layout = _FRAMES.get(frame)
    if layout is None:
        kind = _CLASSES.get(frame[0], ("no quad, hexa or octa", 0))[0]
        return None, f"the geometry of {told} ({kind}) is not known here"
    return layout, f"the vehicle's parameters {told}"


def _with_outputs(layout: RotorLayout | None, reason: str, motors: Mapping[int, int], source: str) -> ParameterFinding:
    """The finding with the outputs of the motors. motors: number of the motor by output."""
    if not motors:
        return ParameterFinding(layout, None, reason)
    found = sorted(motors.values())
    expected = list(range(1, (layout.rotors if layout is not None else len(found)) + 1))
    if found != expected:
        listed = ", ".join(map(str, found))
        wrong = f"{source} has the motors {listed}" + (f", {layout.name} has {layout.rotors}" if layout else "")
        return ParameterFinding(reason=f"the parameters contradict themselves: {wrong}")
    by_motor = {motor: output for output, motor in motors.items()}
    return ParameterFinding(layout, tuple(by_motor[motor] for motor in expected), reason)


def _px4(parameters: Mapping[str, float]) -> ParameterFinding:
    layout, reason = _px4_layout(parameters)
    groups: dict[str, dict[int, int]] = {}
    for name, value in parameters.items():
        found, motor = _PX4_FUNCTION.fullmatch(name), int(value) - _PX4_MOTOR_1 + 1
        if found and 1 <= motor <= _PX4_MOTORS:
            groups.setdefault(found[1], {})[int(found[2])] = motor
    if any(motors != next(iter(groups.values())) for motors in groups.values()):
        several = f"{reason}; the outputs are not known: motors on {', '.join(sorted(groups))}"
        return ParameterFinding(layout, None, several)
    motors = next(iter(groups.values()), {})
    return _with_outputs(layout, reason, motors, f"{next(iter(groups), '')}_FUNCn")


def _px4_layout(parameters: Mapping[str, float]) -> tuple[RotorLayout | None, str]:
    count = int(parameters["CA_ROTOR_COUNT"])
    if parameters.get("CA_AIRFRAME", _AIRFRAME_MULTIROTOR) != _AIRFRAME_MULTIROTOR:
        return None, f"CA_AIRFRAME {parameters['CA_AIRFRAME']:g} is no multirotor"
    names = [f"CA_ROTOR{n}_{part}" for n in range(count) for part in ("PX", "PY", "KM")]
    if missing := [name for name in names if name not in parameters]:
        return None, f"{missing[0]} is not among the parameters"
    if odd := _odd(parameters, count):
        return None, odd
    rows = np.array([parameters[name] for name in names]).reshape(count, 3)
    effects = [(-y, x, moment) for x, y, moment in rows.tolist()]  # of thrust along -z; the body turns against CW
    try:
        layout = layout_of_effects(f"px4-{count}", effects)
    except UsageError as error:
        return None, f"the parameters CA_ROTORn make no layout ({error})"
    told = f"the vehicle's parameters CA_ROTOR0 to CA_ROTOR{count - 1}"
    return next((one for one in LAYOUTS.values() if one.alike(layout)), layout), told


def _odd(parameters: Mapping[str, float], count: int) -> str:
    """Why these rotors are more than places and senses; empty if they are not."""
    for n in range(count):
        axis = [parameters.get(f"CA_ROTOR{n}_{part}", up) for part, up in zip(("AX", "AY", "AZ"), _UP, strict=True)]
        if not np.allclose(axis, _UP, atol=_SAME):
            return f"rotor {n + 1} does not push straight up (CA_ROTOR{n}_AX, _AY, _AZ)"
        if parameters[f"CA_ROTOR{n}_KM"] == 0.0:
            return f"CA_ROTOR{n}_KM is 0: the rotor's sense is not known"
    thrust = [parameters[name] for n in range(count) if (name := f"CA_ROTOR{n}_CT") in parameters]
    if thrust and max(thrust) > min(thrust) * (1 + _SAME):
        return "the rotors differ in thrust (CA_ROTORn_CT)"
    return ""
