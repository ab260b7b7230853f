"""The rotor layout from an autopilot's own parameters, which come from every kind of log and from a link."""

import math
import struct
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import DataFlashMessage, ULogTopic, dataflash, ulog, ulog_message

from mavdiag.airframe.layout import LAYOUTS, Place, layout_at, layout_named
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Autopilot, MavType, MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.vehicles import MOST_PARAMETERS, LinkDecoder, VehicleStream, parameters_in
from mavdiag.logs import read_log
from mavdiag.logs.tlog import decode_tlog, tlog_record
from mavdiag.telemetry import Signal

COPTER_X = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}
INT32, REAL32 = 6, 9
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


def drawn(senses: str, *angles_deg: float) -> list[tuple[float, Literal["cw", "ccw"]]]:
    """+: counter-clockwise."""
    return [(deg, "ccw" if sense == "+" else "cw") for sense, deg in zip(senses, angles_deg, strict=True)]


# From ArduPilot's tables: the place of motor 1, 2, ... by angle from the nose to the right, and its sense.
COPTER: dict[tuple[int, int], list[tuple[float, Literal["cw", "ccw"]]]] = {
    (1, 0): [(90, "ccw"), (-90, "ccw"), (0, "cw"), (180, "cw")],
    (1, 1): [(45, "ccw"), (-135, "ccw"), (-45, "cw"), (135, "cw")],
    (1, 3): [(45, "cw"), (-135, "cw"), (-45, "ccw"), (135, "ccw")],
    (1, 12): [(135, "cw"), (45, "ccw"), (-135, "ccw"), (-45, "cw")],
    (1, 14): [(45, "ccw"), (135, "cw"), (-135, "ccw"), (-45, "cw")],
    (2, 1): [(90, "cw"), (-90, "ccw"), (-30, "cw"), (150, "ccw"), (30, "ccw"), (-150, "cw")],
    (2, 14): [(30, "ccw"), (90, "cw"), (150, "ccw"), (-150, "cw"), (-90, "ccw"), (-30, "cw")],
    (4, 1): [
        *((45, "ccw"), (-45, "cw"), (-135, "ccw"), (135, "cw")),
        *((-45, "ccw"), (45, "cw"), (135, "ccw"), (-135, "cw")),
    ],
    (4, 0): [
        *((0, "ccw"), (-90, "cw"), (180, "ccw"), (90, "cw")),
        *((-90, "ccw"), (0, "cw"), (90, "ccw"), (180, "cw")),
    ],
    (4, 3): [
        *((45, "cw"), (-45, "ccw"), (-135, "cw"), (135, "ccw")),
        *((-45, "cw"), (45, "ccw"), (135, "cw"), (-135, "ccw")),
    ],
    (4, 12): [
        *((135, "cw"), (45, "ccw"), (-135, "ccw"), (-45, "cw")),
        *((135, "ccw"), (45, "cw"), (-135, "cw"), (-45, "ccw")),
    ],
    (4, 14): [
        *((45, "ccw"), (45, "cw"), (135, "cw"), (135, "ccw")),
        *((-135, "ccw"), (-135, "cw"), (-45, "cw"), (-45, "ccw")),
    ],
    (5, 1): drawn("+-+--+", 60, -60, -60, 180, 60, 180),
    (5, 10): drawn("-+-+-+", 60, 60, 180, 180, -60, -60),
    (5, 11): drawn("+++---", 180, 60, -60, 180, 60, -60),
    (12, 1): drawn("+--++--++--+", 30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30),
    (14, 0): drawn("+-+-+-+-+-", 0, 36, 72, 108, 144, 180, -144, -108, -72, -36),
    (14, 14): drawn("+-+-+-+-+-", 18, 54, 90, 126, 162, -162, -126, -90, -54, -18),
    (3, 13): [
        (22.5, "ccw"),
        (-22.5, "cw"),
        (-67.5, "ccw"),
        (-112.5, "cw"),
        (-157.5, "ccw"),
        (157.5, "cw"),
        (112.5, "ccw"),
        (67.5, "cw"),
    ],
}


@pytest.mark.parametrize("frame", COPTER)
def test_frame_class_and_type_are_the_tables_of_ardupilot(frame: tuple[int, int]) -> None:
    found = layout_from_parameters({"FRAME_CLASS": float(frame[0]), "FRAME_TYPE": float(frame[1])})
    assert found.layout is not None
    places = [Place(np.cos(np.radians(deg)), np.sin(np.radians(deg)), spin) for deg, spin in COPTER[frame]]
    np.testing.assert_allclose(found.layout.mixing, layout_at("drawn", places).mixing, atol=1e-8)
    assert found.reason == f"the vehicle's parameters FRAME_CLASS {frame[0]}, FRAME_TYPE {frame[1]}"


@pytest.mark.parametrize("frame", [(4, 1), (5, 1), (5, 10), (12, 1)])
def test_two_rotors_on_an_arm_are_told(frame: tuple[int, int]) -> None:
    found = layout_from_parameters({"FRAME_CLASS": float(frame[0]), "FRAME_TYPE": float(frame[1])})
    assert found.layout is not None
    assert found.layout.coaxial


@pytest.mark.parametrize(
    ("parameters", "kind", "name"),
    [
        ({"FRAME": 0.0}, 2, "plus"),
        ({"FRAME": 1.0}, 2, "x"),
        ({"FRAME": 2.0}, 2, "v"),
        ({"FRAME": 3.0}, 2, "h"),
        ({"FRAME": 1.0}, 13, None),  # a hexa, or a Y6
        ({"FRAME": 1.0}, None, None),
        ({"FRAME": 4.0}, 2, None),
    ],
)
def test_the_frame_of_older_copters_is_that_of_a_quad(
    parameters: dict[str, float], kind: int | None, name: str | None
) -> None:
    found = layout_from_parameters(parameters, kind)
    assert (found.layout.name if found.layout is not None else None) == name
    assert found.outputs is None


def test_the_functions_of_older_copters_are_read_where_there_are_no_newer_ones() -> None:
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


@pytest.mark.parametrize("count", [3e6, 1e9, -4.0, 0.0, 13.0, 4.5, math.nan, math.inf])
def test_a_number_of_rotors_that_cannot_be_is_told(count: float) -> None:
    found = layout_from_parameters({**rotors(*PLACES), "CA_ROTOR_COUNT": count})
    assert found.reason == f"CA_ROTOR_COUNT {count:g} is no number of rotors (1 to 12)"


def test_a_parameter_of_another_name_may_be_anything() -> None:
    odd = {"SYS_AUTOSTART": math.nan, "MPC_XY_CRUISE": math.inf}
    assert layout_from_parameters({**rotors(*PLACES), **odd}) == layout_from_parameters(rotors(*PLACES))
    assert layout_from_parameters({**COPTER_X, **odd}) == layout_from_parameters(COPTER_X)


def test_servo_functions_say_which_output_drives_which_motor() -> None:
    found = layout_from_parameters({**COPTER_X, **servos(0, 0, 36, 33, 34, 0, 35, 10)})
    assert (found.layout, found.outputs) == (layout_named("x"), (4, 5, 7, 3))
    assert layout_from_parameters(COPTER_X).outputs is None
    only_outputs = layout_from_parameters(servos(33, 34, 35, 36, first=5))
    assert (only_outputs.layout, only_outputs.outputs) == (None, (5, 6, 7, 8))


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({}, ""),
        ({"FRAME": 1.0, "THR_MIN": 130.0}, ""),
        ({"FRAME_CLASS": 1.0}, "FRAME_TYPE is not among the parameters"),
        ({"FRAME_CLASS": 1.0, "FRAME_TYPE": 4.0}, "the geometry of FRAME_CLASS 1, FRAME_TYPE 4 (quad) is not known"),
        ({"FRAME_CLASS": 6.0, "FRAME_TYPE": 0.0}, "FRAME_CLASS 6, FRAME_TYPE 0 (a class without a table)"),
        ({**COPTER_X, **servos(33, 34, 35)}, "SERVOn_FUNCTION has the motors 1, 2, 3, x has 4"),
        ({**COPTER_X, **servos(33, 34, 35, 36, 37)}, "motors 1, 2, 3, 4, 5, x has 4"),
        ({**COPTER_X, **servos(33, 34, 35, 36, 33)}, "motors 1, 1, 2, 3, 4, x has 4"),
        ({**COPTER_X, **rotors(*PLACES)}, "of two autopilots"),
        ({**rotors(*PLACES), "CA_AIRFRAME": 2.0}, "CA_AIRFRAME 2 is no multirotor"),
        ({**rotors(*PLACES), "CA_ROTOR_COUNT": 5.0}, "CA_ROTOR4_PX is not among the parameters"),
        ({**rotors(*PLACES), "CA_ROTOR2_AZ": 0.0, "CA_ROTOR2_AX": 1.0}, "rotor 3 does not push straight up"),
        ({**rotors(*PLACES), "CA_ROTOR3_KM": 0.0}, "CA_ROTOR3_KM is 0"),
        ({**rotors(*PLACES), "CA_ROTOR0_CT": 6.5, "CA_ROTOR1_CT": 9.0}, "differ in thrust"),
        (rotors((0.1, 0, 0.05), (-0.1, 0, 0.05), (0.2, 0, -0.05)), "make no layout"),
    ],
)
def test_what_is_unknown_or_contradicts_itself_has_a_reason(parameters: dict[str, float], reason: str) -> None:
    found = layout_from_parameters(parameters)
    assert (found.layout, found.outputs) == (None, None)
    assert reason in found.reason
    assert bool(reason) == bool(found.reason)


def test_px4_rotors_are_places_and_senses() -> None:
    """A positive KM is counter-clockwise, and turns the nose to the right."""
    square = tuple((x, y / 0.2 * 0.15, km) for x, y, km in PLACES)
    assert layout_from_parameters(rotors(*square)).layout is layout_named("x")
    found = layout_from_parameters({**rotors(*PLACES), **outputs("PWM_MAIN", 3, 1, 4, 2, first=2)})
    assert found.outputs == (3, 5, 2, 4)
    assert found.layout is not None
    assert np.sign(found.layout.mixing).tolist() == np.sign(layout_named("x").mixing).tolist()
    hexa = [(x, y, 0.05 if spin == "ccw" else -0.05) for x, y, spin in
            [(0, 1, "cw"), (0, -1, "ccw"), (0.8660254, -0.5, "cw"), (-0.8660254, 0.5, "ccw"), (0.8660254, 0.5, "ccw"),
             (-0.8660254, -0.5, "cw")]]  # fmt: skip
    assert layout_from_parameters(rotors(*hexa)).layout is layout_named("hexa-x")


def test_px4_outputs_in_two_groups_must_agree() -> None:
    both = {**rotors(*PLACES), **outputs("PWM_MAIN", 1, 2, 3, 4), **outputs("HIL_ACT", 1, 2, 3, 4)}
    assert layout_from_parameters(both).outputs == (1, 2, 3, 4)
    split = layout_from_parameters({**rotors(*PLACES), **outputs("PWM_MAIN", 1, 2), **outputs("PWM_AUX", 3, 4)})
    assert split.layout is not None
    assert split.outputs is None
    assert "motors on PWM_AUX, PWM_MAIN" in split.reason


PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")
RCOU = DataFlashMessage(33, "RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6")


def test_a_dataflash_log_carries_the_last_value_of_each_parameter(tmp_path: Path) -> None:
    named = {**COPTER_X, **servos(33, 34, 35, 36)}
    records = [PARM.record(1, b"FRAME_TYPE", 0.0)]
    records += [PARM.record(2, name.encode(), value) for name, value in named.items()]
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash([PARM, RCOU], [*records, RCOU.record(3, *[1100] * 6)]))
    log = read_log(path)
    assert log.parameters == named
    assert log.motor_order
    assert layout_from_parameters(log.parameters).layout is layout_named("x")
    path.write_bytes(dataflash([PARM, RCOU], [PARM.record(1, b"A", 1.0), RCOU.record(3, *[1100] * 6)]))
    assert not read_log(path).motor_order


def test_several_outputs_of_one_motor_do_not_shift_the_others(tmp_path: Path) -> None:
    records = [PARM.record(2, name.encode(), value) for name, value in servos(33, 33, 34, 35, 36).items()]
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash([PARM, RCOU], [*records, RCOU.record(3, 1100, 1200, 1300, 1400, 1500, 0)]))
    assert read_log(path).telemetry.need(Signal.ACTUATOR).values[0].tolist() == pytest.approx([0.1, 0.3, 0.4, 0.5])


MOTORS = ULogTopic(4, "actuator_motors", (("uint64_t", "timestamp"), ("float[12]", "control")))
PULSES = ULogTopic(5, "actuator_outputs", (("uint64_t", "timestamp"), ("float[16]", "output")))


def parameter(kind: str, name: str, value: float) -> bytes:
    """A ULog parameter message."""
    key = f"{kind} {name}".encode()
    return ulog_message(
        "P", struct.pack("<B", len(key)) + key + struct.pack("<i" if kind == "int32_t" else "<f", value)
    )


def test_a_ulog_carries_its_first_parameters_and_their_changes(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    data = [parameter("float", "CA_ROTOR0_PX", 0.1), parameter("int32_t", "CA_ROTOR_COUNT", 4)]
    content = ulog([MOTORS], [MOTORS.record(1, *[0.5] * 12), parameter("int32_t", "CA_ROTOR_COUNT", 6)])
    head = 16  # bytes before the definitions
    path.write_bytes(content[:head] + b"".join(data) + content[head:])
    log = read_log(path)
    assert log.parameters == {"CA_ROTOR0_PX": pytest.approx(0.1), "CA_ROTOR_COUNT": 6.0}
    assert log.motor_order


def test_the_columns_of_a_ulog_are_its_outputs(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    pulses = [0, 0, 1500, 900, 1200, 0]
    path.write_bytes(ulog([PULSES], [PULSES.record(t, *pulses[:4], 1200 + t, *[0] * 11) for t in (1, 2)]))
    log = read_log(path)
    assert log.telemetry.need(Signal.ACTUATOR).values[0].tolist() == pytest.approx([0, 0, 0.5, 0, 0.201])
    assert not log.motor_order


def value(encoder: Encoder, name: str, number: float, kind: int) -> bytes:
    """A PARAM_VALUE as the autopilot of the encoder's user would send it."""
    return encoder.encode(MessageId.PARAM_VALUE, name.encode(), number, kind, 100, 0xFFFF)


def as_bytes(number: int) -> float:
    """The float whose bytes are those of an integer."""
    return float(np.array([number], dtype="<i4").view("<f4")[0])


@pytest.mark.parametrize("autopilot", [Autopilot.ARDUPILOTMEGA, Autopilot.PX4])
def test_integers_are_cast_by_ardupilot_and_copied_by_px4(autopilot: Autopilot) -> None:
    encoder = Encoder(1, 1)
    whole = {"FRAME_CLASS": 2, "A_NAME_OF_SIXTEE": 1_000_003, "SMALL": 0}
    frames = [value(encoder, k, as_bytes(v) if autopilot is Autopilot.PX4 else v, INT32) for k, v in whole.items()]
    frames += [value(encoder, "REAL", 0.25, REAL32), value(encoder, "BROKEN", float("nan"), REAL32)]
    frames.append(value(Encoder(1, 191), "FRAME_CLASS", 7.0, REAL32))  # of another component
    content = decode_tlog(b"".join(tlog_record(1, one) for one in frames))
    assert len(content.frames) == len(frames)
    assert parameters_in(content.frames, autopilot) == {**whole, "REAL": 0.25}


def stream(autopilot: Autopilot, parameters: dict[str, float]) -> list[bytes]:
    """Three seconds of a vehicle, and its parameters once."""
    encoder, found = Encoder(1, 1), []
    for k in range(300):
        data = [encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, autopilot, 128, 0, 4, 3)] if k % 100 == 0 else []
        data.append(encoder.encode(MessageId.ATTITUDE_TARGET, 5000 + 10 * k, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5))
        data.append(encoder.encode(MessageId.RAW_IMU, 5_000_000 + 10_000 * k, 0, 0, -1000, 1, 2, 3))
        found.append(b"".join(data))
    found[1] += b"".join(value(encoder, name, number, REAL32) for name, number in parameters.items())
    return found


def test_a_tlog_and_a_link_carry_the_parameters_that_pass_by(tmp_path: Path) -> None:
    named = {**COPTER_X, **servos(33, 34, 35, 36)}
    sent = stream(Autopilot.ARDUPILOTMEGA, named)
    decoder = LinkDecoder(datagrams=False)
    for k, data in enumerate(sent):
        received = decoder.feed([(data, (k + 1) * 10_000_000)], (k + 1) * 10_000_000)
    assert received[1].parameters == named  # they came before the vehicle entered
    encoder = Encoder(1, 1)
    again = decoder.feed([(value(encoder, "FRAME_TYPE", 0.0, REAL32), 4_000_000_000)], 4_000_000_000)
    assert again[1].parameters == {**named, "FRAME_TYPE": 0.0}


def test_made_up_parameters_cost_a_bounded_amount() -> None:
    encoder = Encoder(1, 1)
    frames = decode_tlog(
        b"".join(tlog_record(1, value(encoder, f"P{n}", 1.0, REAL32)) for n in range(MOST_PARAMETERS + 1))
    ).frames
    stream = VehicleStream(PROFILES["ardupilot"])
    for some in (frames[:-1], frames[-1:]):
        stream.step(some)
        assert len(stream.parameters) == MOST_PARAMETERS


def test_parameter_layouts_have_names_of_their_own() -> None:
    for frame in COPTER:
        layout = layout_from_parameters({"FRAME_CLASS": float(frame[0]), "FRAME_TYPE": float(frame[1])}).layout
        assert layout is not None
        assert layout.name not in LAYOUTS or layout is LAYOUTS[layout.name]
