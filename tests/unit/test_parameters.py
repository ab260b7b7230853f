"""The rotor layout from an autopilot's own parameters, which come from every kind of log and from a link."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import DataFlashMessage, dataflash

from mavdiag.airframe.layout import LAYOUTS, Place, layout_at, layout_named
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Autopilot, MavType, MessageId
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.logs import read_log

COPTER_X = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}
REAL32 = 9
PLACES = ((0.15, 0.2, 0.05), (-0.15, -0.2, 0.05), (0.15, -0.2, -0.05), (-0.15, 0.2, -0.05))  # x, y, KM: PX4's quad x


def servos(*functions: int, first: int = 1) -> dict[str, float]:
    return {f"SERVO{first + i}_FUNCTION": float(one) for i, one in enumerate(functions)}


def rotors(*rows: tuple[float, float, float]) -> dict[str, float]:
    named = {
        f"CA_ROTOR{n}_{part}": v for n, row in enumerate(rows) for part, v in zip(("PX", "PY", "KM"), row, strict=True)
    }
    return {"CA_ROTOR_COUNT": float(len(rows)), "CA_AIRFRAME": 0.0, **named}


def outputs(group: str, *motors: int, first: int = 1) -> dict[str, float]:
    return {f"{group}_FUNC{first + i}": float(100 + motor) for i, motor in enumerate(motors)}


# From ArduPilot's tables: the place of motor 1, 2, ... by angle from the nose to the right; +: counter-clockwise.
COPTER: dict[tuple[int, int], tuple[str, tuple[float, ...]]] = {
    (1, 0): ("++--", (90, -90, 0, 180)),
    (1, 1): ("++--", (45, -135, -45, 135)),
    (1, 12): ("-++-", (135, 45, -135, -45)),
    (2, 1): ("-+-++-", (90, -90, -30, 150, 30, -150)),
    (4, 0): ("+-+-+-+-", (0, -90, 180, 90, -90, 0, 90, 180)),
    (4, 12): ("-++-+--+", (135, 45, -135, -45, 135, 45, -135, -45)),
    (5, 1): ("+-+--+", (60, -60, -60, 180, 60, 180)),
    (12, 1): ("+--++--++--+", (30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30)),
    (14, 0): ("+-+-+-+-+-", (0, 36, 72, 108, 144, 180, -144, -108, -72, -36)),
}


@pytest.mark.parametrize("frame", COPTER)
def test_frame_class_and_type_are_the_tables_of_ardupilot(frame: tuple[int, int]) -> None:
    found = layout_from_parameters({"FRAME_CLASS": float(frame[0]), "FRAME_TYPE": float(frame[1])})
    assert found.layout is not None
    senses, angles_deg = COPTER[frame]
    places = [
        Place(math.cos(math.radians(deg)), math.sin(math.radians(deg)), "ccw" if sense == "+" else "cw")
        for sense, deg in zip(senses, angles_deg, strict=True)
    ]
    np.testing.assert_allclose(found.layout.mixing, layout_at("drawn", places).mixing, atol=1e-8)
    assert found.reason == f"the vehicle's parameters FRAME_CLASS {frame[0]}, FRAME_TYPE {frame[1]}"
    assert found.layout.coaxial == (len(set(angles_deg)) < len(angles_deg))
    assert found.layout.name not in LAYOUTS or found.layout is LAYOUTS[found.layout.name]


@pytest.mark.parametrize(
    ("frame", "kind", "name"),
    [(0, 2, "plus"), (1, 2, "x"), (2, 2, "v"), (3, 2, "h"), (1, 13, None), (1, None, None), (4, 2, None)],
)
def test_the_frame_of_older_copters_is_that_of_a_quad(frame: int, kind: int | None, name: str | None) -> None:
    found = layout_from_parameters({"FRAME": float(frame)}, kind)
    assert (found.layout.name if found.layout is not None else None) == name
    assert found.outputs is None


def test_servo_functions_say_which_output_drives_which_motor() -> None:
    found = layout_from_parameters({**COPTER_X, **servos(0, 0, 36, 33, 34, 0, 35, 10)})
    assert (found.layout, found.outputs) == (layout_named("x"), (4, 5, 7, 3))
    assert layout_from_parameters(COPTER_X).outputs is None
    only_outputs = layout_from_parameters(servos(33, 34, 35, 36, first=5))
    assert (only_outputs.layout, only_outputs.outputs) == (None, (5, 6, 7, 8))
    old = {f"RC{n}_FUNCTION": float(one) for n, one in enumerate((33, 34, 35, 36), start=5)}
    assert layout_from_parameters(old).outputs == (5, 6, 7, 8)
    assert layout_from_parameters({**servos(34, 33, 36, 35), "RC9_FUNCTION": 33.0}).outputs == (2, 1, 4, 3)


NUMBERS = st.one_of(st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -4.0, 0.5, 3e6, 1e9]), st.floats())
NAMES = ("FRAME_CLASS", "FRAME_TYPE", "FRAME", "CA_AIRFRAME", "SERVO1_FUNCTION", "SERVO2_FUNCTION", "PWM_MAIN_FUNC1")


@given(
    st.dictionaries(st.sampled_from([*NAMES, "CA_ROTOR_COUNT", *rotors(*PLACES), "SOMETHING"]), NUMBERS), st.booleans()
)
def test_no_value_of_a_parameter_is_an_exception_or_a_long_list(wrong: dict[str, float], px4: bool) -> None:
    sound = {**rotors(*PLACES), **outputs("PWM_MAIN", 1, 2, 3, 4)} if px4 else {**COPTER_X, **servos(33, 34, 35, 36)}
    found = layout_from_parameters({**sound, **wrong})
    assert found.layout is None or found.layout.rotors <= 12
    assert found.layout is not None or found.outputs is not None or found.reason
    odd = {"SYS_AUTOSTART": math.nan, "MPC_XY_CRUISE": math.inf}
    assert layout_from_parameters({**sound, **odd}) == layout_from_parameters(sound)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({}, ""),
        ({"FRAME": 1.0, "THR_MIN": 130.0}, ""),
        ({"FRAME_CLASS": 1.0}, "FRAME_TYPE is not among the parameters"),
        ({"FRAME_CLASS": 1.0, "FRAME_TYPE": 4.0}, "the geometry of FRAME_CLASS 1, FRAME_TYPE 4 is not known"),
        ({"FRAME_CLASS": 6.0, "FRAME_TYPE": 0.0}, "FRAME_CLASS 6, FRAME_TYPE 0 is not known"),
        ({**COPTER_X, **servos(33, 34, 35)}, "SERVOn_FUNCTION has the motors 1, 2, 3, x has 4"),
        ({**COPTER_X, **servos(33, 34, 35, 36, 33)}, "motors 1, 1, 2, 3, 4, x has 4"),
        ({**COPTER_X, **rotors(*PLACES)}, "of two autopilots"),
        ({**rotors(*PLACES), "CA_AIRFRAME": 2.0}, "CA_AIRFRAME 2 is no multirotor"),
        ({**rotors(*PLACES), "CA_ROTOR_COUNT": 5.0}, "CA_ROTOR4_PX is not among the parameters"),
        ({**rotors(*PLACES), "CA_ROTOR2_AZ": 0.0, "CA_ROTOR2_AX": 1.0}, "rotor 3 does not push straight up"),
        ({**rotors(*PLACES), "CA_ROTOR3_KM": 0.0}, "CA_ROTOR3_KM is 0"),
        ({**rotors(*PLACES), "CA_ROTOR0_CT": 6.5, "CA_ROTOR1_CT": 9.0}, "differ in thrust"),
        (rotors((0.1, 0, 0.05), (-0.1, 0, 0.05), (0.2, 0, -0.05)), "make no layout"),
        *(
            ({**rotors(*PLACES), "CA_ROTOR_COUNT": n}, f"CA_ROTOR_COUNT {n:g} is no number of rotors (1 to 12)")
            for n in (1e9, -4.0, 0.0, 13.0, 4.5, math.nan)
        ),
    ],
)
def test_what_is_unknown_or_contradicts_itself_has_a_reason(parameters: dict[str, float], reason: str) -> None:
    found = layout_from_parameters(parameters)
    assert (found.layout, found.outputs) == (None, None)
    assert reason in found.reason
    assert bool(reason) == bool(found.reason)


def test_px4_rotors_are_places_and_senses_and_its_groups_of_outputs_must_agree() -> None:
    """A positive KM is counter-clockwise, and turns the nose to the right."""
    square = tuple((x, y / 0.2 * 0.15, km) for x, y, km in PLACES)
    assert layout_from_parameters(rotors(*square)).layout is layout_named("x")
    found = layout_from_parameters({**rotors(*PLACES), **outputs("PWM_MAIN", 3, 1, 4, 2, first=2)})
    assert found.outputs == (3, 5, 2, 4)
    assert found.layout is not None
    assert np.sign(found.layout.mixing).tolist() == np.sign(layout_named("x").mixing).tolist()
    hexa = [(math.cos(math.radians(deg)), math.sin(math.radians(deg))) for deg in (90, -90, -30, 150, 30, -150)]
    moments = (-0.05, 0.05, -0.05, 0.05, 0.05, -0.05)
    seen = layout_from_parameters(rotors(*((x, y, km) for (x, y), km in zip(hexa, moments, strict=True))))
    assert seen.layout is layout_named("hexa-x")
    both = {**rotors(*PLACES), **outputs("PWM_MAIN", 1, 2, 3, 4), **outputs("HIL_ACT", 1, 2, 3, 4)}
    assert layout_from_parameters(both).outputs == (1, 2, 3, 4)
    split = layout_from_parameters({**rotors(*PLACES), **outputs("PWM_MAIN", 1, 2), **outputs("PWM_AUX", 3, 4)})
    assert (split.layout is None, split.outputs) == (False, None)
    assert "motors on PWM_AUX, PWM_MAIN" in split.reason


PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")
RCOU = DataFlashMessage(33, "RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6")


def test_a_dataflash_log_carries_the_last_value_of_each_parameter(tmp_path: Path) -> None:
    named, path = {**COPTER_X, **servos(33, 34, 35, 36)}, tmp_path / "log.bin"
    records = [PARM.record(1, b"FRAME_TYPE", 0.0)]
    records += [PARM.record(2, name.encode(), value) for name, value in named.items()]
    path.write_bytes(dataflash([PARM, RCOU], [*records, RCOU.record(3, *[1100] * 6)]))
    log = read_log(path)
    assert (log.parameters, log.motor_order) == (named, True)
    path.write_bytes(dataflash([PARM, RCOU], [PARM.record(1, b"A", 1.0), RCOU.record(3, *[1100] * 6)]))
    assert not read_log(path).motor_order


def value(encoder: Encoder, name: str, number: float, kind: int) -> bytes:
    """A PARAM_VALUE as the autopilot of the encoder's user would send it."""
    return encoder.encode(MessageId.PARAM_VALUE, name.encode(), number, kind, 100, 0xFFFF)


def test_a_link_carries_the_parameters_that_pass_by_before_the_vehicle_entered_and_after() -> None:
    named, encoder = {**COPTER_X, **servos(33, 34, 35, 36)}, Encoder(1, 1)
    decoder, beat = LinkDecoder(datagrams=False), (MavType.QUADROTOR, Autopilot.ARDUPILOTMEGA, 128, 0, 4, 3)
    for k in range(300):
        data = encoder.encode(MessageId.HEARTBEAT, *beat) if k % 100 == 0 else b""
        data += encoder.encode(MessageId.ATTITUDE_TARGET, 5000 + 10 * k, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5)
        data += encoder.encode(MessageId.RAW_IMU, 5_000_000 + 10_000 * k, 0, 0, -1000, 1, 2, 3)
        data += b"".join(value(encoder, *pair, REAL32) for pair in named.items()) if k == 1 else b""
        received = decoder.feed([(data, (k + 1) * 10_000_000)], (k + 1) * 10_000_000)
    assert received[1].parameters == named
    again = decoder.feed([(value(Encoder(1, 1), "FRAME_TYPE", 0.0, REAL32), 4_000_000_000)], 4_000_000_000)
    assert again[1].parameters == {**named, "FRAME_TYPE": 0.0}
