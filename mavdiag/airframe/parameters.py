"""The rotor layout and its outputs from the autopilot's own parameters, where these state both with certainty.

ArduPilot: FRAME_CLASS and FRAME_TYPE name a table of motors (AP_MotorsMatrix.cpp); SERVOn_FUNCTION 33 to 40 puts motor
1 to 8 on output n (82 to 85: motor 9 to 12). Up to Copter 3.4 FRAME was the type, and the functions RCn_FUNCTION.
PX4: CA_ROTOR_COUNT, and for rotor n from 0 its place CA_ROTORn_PX, _PY [m] (FRD) and its moment coefficient
CA_ROTORn_KM, positive for CCW seen from above (control_allocator/module.yaml), which turns the nose to the right;
<group>_FUNCn 101 to 112 puts motor 1 to 12 on output n of that group.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from mavdiag.airframe.layout import LAYOUTS, RotorLayout, layout_named, layout_of_effects, ring
from mavdiag.airframe.vehicle_type import QUAD
from mavdiag.errors import UsageError

COPTER_MOTORS = (33, 34, 35, 36, 37, 38, 39, 40, 82, 83, 84, 85)  # SERVOn_FUNCTION of motor 1, 2, ...
_MOST_ROTORS = 12  # of ArduPilot and of CA_ROTOR_COUNT
_LARGEST = 1e6  # no parameter that is read here has a larger value
_PX4_MOTOR_1 = 101
_OLD_FRAMES = (0, 1, 2, 3)  # plus, X, V, H
_SERVO = re.compile(r"(SERVO|RC)(\d{1,2})_FUNCTION")
_PX4_FUNCTION = re.compile(r"(PWM_MAIN|PWM_AUX|HIL_ACT|UAVCAN_EC)_FUNC(\d+)")
_AIRFRAME_MULTIROTOR = 0  # CA_AIRFRAME
_UP = (0.0, 0.0, -1.0)  # CA_ROTORn_AX, _AY, _AZ by default
_SAME = 1e-3  # of an axis or of the thrust coefficients: closer ones are the same (our choice)


# By FRAME_CLASS and FRAME_TYPE. The V's two rear rotors turn it more than its two front ones.
_NAMED = {(1, 0): "plus", (1, 1): "x", (2, 0): "hexa-plus", (2, 1): "hexa-x", (3, 0): "octo-plus", (3, 1): "octo-x"}
_NAMED |= {(4, 1): "x8", **{(5, kind): "y6" for kind in range(22)}, (5, 10): "y6b"}
_NAMED |= {(14, 0): "deca-plus", (14, 1): "deca-x", (14, 14): "deca-x"}
_X8 = (45, -45, -135, 135, -45, 45, 135, -135)
_X8_BETAFLIGHT = (135, 45, -135, -45, 135, 45, -135, -45)
_FRAMES: Mapping[tuple[int, int], RotorLayout] = {
    **{key: layout_named(name) for key, name in _NAMED.items()},
    (1, 2): ring("v", 45, -135, -45, 135, cw=(3, 4), yaw=(0.7981, 1.0, 0.7981, 1.0)),
    (1, 3): ring("h", 45, -135, -45, 135, cw=(1, 2)),
    (1, 6): ring("plus-reversed", 90, -90, 0, 180, cw=(1, 2)),
    (1, 12): ring("x-betaflight", 135, 45, -135, -45, cw=(1, 4)),
    (1, 13): ring("x-dji", 45, -45, -135, 135, cw=(2, 4)),
    (1, 14): ring("x-clockwise", 45, 135, -135, -45, cw=(2, 4)),
    (1, 18): ring("x-betaflight-reversed", 135, 45, -135, -45, cw=(2, 3)),
    (2, 13): ring("hexa-x-dji", 30, -30, -90, -150, 150, 90, cw=(2, 4, 6)),
    (2, 14): ring("hexa-x-clockwise", 30, 90, 150, -150, -90, -30, cw=(2, 4, 6)),
    (3, 13): ring("octo-x-dji", 22.5, -22.5, -67.5, -112.5, -157.5, 157.5, 112.5, 67.5, cw=(2, 4, 6, 8)),
    (3, 14): ring("octo-x-clockwise", 22.5, 67.5, 112.5, 157.5, -157.5, -112.5, -67.5, -22.5, cw=(2, 4, 6, 8)),
    (4, 0): ring("x8-plus", 0, -90, 180, 90, -90, 0, 90, 180, cw=(2, 4, 6, 8)),
    (4, 2): ring("x8-v", *_X8, cw=(2, 4, 6, 8), yaw=(0.7981, 0.7981, 1.0, 1.0, 0.7981, 0.7981, 1.0, 1.0)),
    (4, 3): ring("x8-h", *_X8, cw=(1, 3, 5, 7)),
    (4, 12): ring("x8-betaflight", *_X8_BETAFLIGHT, cw=(1, 4, 6, 7)),
    (4, 14): ring("x8-clockwise", 45, 45, 135, 135, -135, -135, -45, -45, cw=(2, 3, 6, 7)),
    (4, 18): ring("x8-betaflight-reversed", *_X8_BETAFLIGHT, cw=(2, 3, 5, 8)),
    (5, 11): ring("y6f", 180, 60, -60, 180, 60, -60, cw=(4, 5, 6)),
    (12, 0): ring("dodecahexa-plus", 0, 0, 60, 60, 120, 120, 180, 180, -120, -120, -60, -60, cw=(2, 3, 6, 7, 10, 11)),
    (12, 1): ring("dodecahexa-x", 30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30, cw=(2, 3, 6, 7, 10, 11)),
}


@dataclass(frozen=True, slots=True)
class ParameterFinding:
    """The layout and the output, from 1, of motor 1, 2, ...; None if the parameters do not say it, or contradict it."""

    layout: RotorLayout | None = None
    outputs: tuple[int, ...] | None = None
    reason: str = ""  # what both rest on, or why one is not known; empty if the parameters say nothing of rotors


def layout_from_parameters(parameters: Mapping[str, float], mav_type: int | None = None) -> ParameterFinding:
    """Read what an autopilot's parameters, by name and as floats, say of its rotors. mav_type: MAV_TYPE, if known.

    >>> layout_from_parameters({"FRAME_CLASS": 1, "FRAME_TYPE": 0}).layout.name
    'plus'
    """
    px4, copter = "CA_ROTOR_COUNT" in parameters, "FRAME_CLASS" in parameters
    if px4 and copter:
        return ParameterFinding(reason="the parameters are of two autopilots (FRAME_CLASS and CA_ROTOR_COUNT)")
    if px4:
        return _px4(parameters)
    layout, reason = _copter_layout(parameters) if copter else _old_layout(parameters, mav_type)
    functions = output_functions(parameters)
    motors = {output: COPTER_MOTORS.index(one) + 1 for output, one in functions.items() if one in COPTER_MOTORS}
    return _with_outputs(layout, reason, motors, "SERVOn_FUNCTION")


def output_functions(parameters: Mapping[str, float]) -> dict[int, int]:
    """ArduPilot's function of each output, from 1, that has one (SERVOn_FUNCTION, or RCn_FUNCTION up to Copter 3.4)."""
    named = {name: found for name in parameters if (found := _SERVO.fullmatch(name))}
    prefix = "SERVO" if any(found[1] == "SERVO" for found in named.values()) else "RC"
    told = {int(found[2]): _whole(parameters, name) for name, found in named.items() if found[1] == prefix}
    return {output: function for output, function in told.items() if function}


def _whole(parameters: Mapping[str, float], name: str) -> int | None:
    """A parameter that is a whole number; None if it is not told, or cannot be one."""
    value = parameters.get(name, math.nan)
    return int(value) if abs(value) <= _LARGEST and value == int(value) else None


def _copter_layout(parameters: Mapping[str, float]) -> tuple[RotorLayout | None, str]:
    if "FRAME_TYPE" not in parameters:
        return None, "FRAME_TYPE is not among the parameters"
    frame_class, frame_type = _whole(parameters, "FRAME_CLASS"), _whole(parameters, "FRAME_TYPE")
    if frame_class is None or frame_type is None:
        return None, "FRAME_CLASS and FRAME_TYPE are no whole numbers"
    told = f"FRAME_CLASS {frame_class}, FRAME_TYPE {frame_type}"
    layout = _FRAMES.get((frame_class, frame_type))
    return layout, f"the vehicle's parameters {told}" if layout else f"the geometry of {told} is not known here"


def _old_layout(parameters: Mapping[str, float], mav_type: int | None) -> tuple[RotorLayout | None, str]:
    """By FRAME, as Copter up to 3.4 has it. It has one type for all classes, and only a quad is told by MAV_TYPE."""
    frame_type = _whole(parameters, "FRAME")
    if frame_type not in _OLD_FRAMES or mav_type != QUAD:
        return None, ""
    return _FRAMES[1, frame_type], f"the vehicle's parameter FRAME {frame_type} of a quad"


def _with_outputs(layout: RotorLayout | None, reason: str, motors: Mapping[int, int], source: str) -> ParameterFinding:
    """The finding with the outputs of the motors. motors: number of the motor by output."""
    if not motors:
        return ParameterFinding(layout, None, reason)
    found = sorted(motors.values())
    if found != list(range(1, (layout.rotors if layout is not None else len(found)) + 1)):
        wrong = f"{source} has the motors {', '.join(map(str, found))}"
        wrong += f", {layout.name} has {layout.rotors}" if layout else ""
        return ParameterFinding(reason=f"the parameters contradict themselves: {wrong}")
    return ParameterFinding(layout, tuple(sorted(motors, key=motors.__getitem__)), reason)


def _px4(parameters: Mapping[str, float]) -> ParameterFinding:
    layout, reason = _px4_layout(parameters)
    groups: dict[str, dict[int, int]] = {}
    for name in parameters:
        found = _PX4_FUNCTION.fullmatch(name)
        motor = (_whole(parameters, name) or 0) - _PX4_MOTOR_1 + 1 if found else 0
        if found and 1 <= motor <= _MOST_ROTORS:
            groups.setdefault(found[1], {})[int(found[2])] = motor
    group, motors = next(iter(groups.items()), ("", {}))
    if any(others != motors for others in groups.values()):
        several = f"{reason}; the outputs are not known: motors on {', '.join(sorted(groups))}"
        return ParameterFinding(layout, None, several)
    return _with_outputs(layout, reason, motors, f"{group}_FUNCn")


def _px4_layout(parameters: Mapping[str, float]) -> tuple[RotorLayout | None, str]:
    count = _whole(parameters, "CA_ROTOR_COUNT") or 0
    if odd := next(_px4_doubts(parameters, count), ""):
        return None, odd
    place = [[parameters[f"CA_ROTOR{n}_{part}"] for part in ("PX", "PY", "KM")] for n in range(count)]
    try:  # the effects of thrust along -z; the body turns against CW
        layout = layout_of_effects(f"px4-{count}", [(-y, x, moment) for x, y, moment in place])
    except UsageError as error:
        return None, f"the parameters CA_ROTORn make no layout ({error})"
    told = f"the vehicle's parameters CA_ROTOR0 to CA_ROTOR{count - 1}"
    return next((one for one in LAYOUTS.values() if one.alike(layout)), layout), told


def _px4_doubts(parameters: Mapping[str, float], count: int) -> Iterator[str]:
    """Why these rotors are not known, or are more than places and senses."""
    if not 0 < count <= _MOST_ROTORS:
        yield f"CA_ROTOR_COUNT {parameters['CA_ROTOR_COUNT']:g} is no number of rotors (1 to {_MOST_ROTORS})"
    if parameters.get("CA_AIRFRAME", _AIRFRAME_MULTIROTOR) != _AIRFRAME_MULTIROTOR:
        yield f"CA_AIRFRAME {parameters['CA_AIRFRAME']:g} is no multirotor"
    for name in (f"CA_ROTOR{n}_{part}" for n in range(count) for part in ("PX", "PY", "KM")):
        if not abs(parameters.get(name, math.inf)) <= _LARGEST:
            yield f"{name} is not among the parameters"
    for n in range(count):
        axis = [parameters.get(f"CA_ROTOR{n}_{part}", up) for part, up in zip(("AX", "AY", "AZ"), _UP, strict=True)]
        if not np.allclose(axis, _UP, atol=_SAME):
            yield f"rotor {n + 1} does not push straight up (CA_ROTOR{n}_AX, _AY, _AZ)"
        if parameters[f"CA_ROTOR{n}_KM"] == 0.0:
            yield f"CA_ROTOR{n}_KM is 0: the rotor's sense is not known"
    thrust = [parameters[name] for n in range(count) if (name := f"CA_ROTOR{n}_CT") in parameters]
    if thrust and max(thrust) > min(thrust) * (1 + _SAME):
        yield "the rotors differ in thrust (CA_ROTORn_CT)"
