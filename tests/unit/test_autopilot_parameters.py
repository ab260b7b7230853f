"""The emulated autopilot's parameters: listed, read, set within type and range, and encoded as each autopilot does."""

import struct

import pytest

from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.layout import Argument
from mavdiag.link.messages import Autopilot as Maker
from mavdiag.link.messages import MessageId
from mavdiag.link.parameters import Encoding, Kind, Parameter, Parameters, parameters_in
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.vehicle import airframe_of, shipped_vehicles, vehicle_named

PLANT = (1, 1)
ROWS = (Parameter("FIXED", 20.0), Parameter("COUNT", 1, Kind.INT32, (0, 3)), Parameter("SPEED", 1.5, span=(0.5, 2.0)))


def frame(msgid: int, *fields: Argument) -> Frame:
    return Decoder().feed(Encoder(255, 190).encode(msgid, *PLANT, *fields), 0)[0]


def told(one: Parameters, msgid: int, *fields: Argument) -> list[tuple[Argument, ...]]:
    asked = frame(msgid, *fields)
    if msgid == MessageId.PARAM_SET:
        one.change(*one.wanted(asked))
    return one.told(asked)


@pytest.mark.parametrize("encoding", list(Encoding))
def test_all_are_listed_and_each_is_read_by_name_or_index(encoding: Encoding) -> None:
    one = Parameters(ROWS, encoding)
    every, count = told(one, MessageId.PARAM_REQUEST_LIST), 9 if encoding is Encoding.FLOAT else 6
    assert [(row[0], *row[2:]) for row in every] == [("FIXED", 9, 3, 0), ("COUNT", count, 3, 1), ("SPEED", 9, 3, 2)]
    assert told(one, MessageId.PARAM_REQUEST_READ, "COUNT", -1) == every[1:2]
    assert told(one, MessageId.PARAM_REQUEST_READ, "", 2) == every[2:]
    for name, index in (("NO_SUCH", -1), ("", 3)):
        assert told(one, MessageId.PARAM_REQUEST_READ, name, index) == []


@pytest.mark.parametrize("encoding", list(Encoding))
@pytest.mark.parametrize(
    ("name", "value", "kind", "in_force"),
    [
        ("SPEED", 1.75, 9, 1.75),
        ("SPEED", 2.5, 9, 1.5),
        ("SPEED", float("nan"), 9, 1.5),
        ("FIXED", 30.0, 9, 20.0),
        ("COUNT", 3, 6, 3),
        ("COUNT", 4, 6, 1),
    ],
)
def test_a_set_is_checked_and_answered_by_the_value_in_force(
    encoding: Encoding, name: str, value: float, kind: int, in_force: float
) -> None:
    one = Parameters(ROWS, encoding)
    sent = (
        struct.unpack("<f", struct.pack("<i", round(value)))[0] if encoding is Encoding.BYTES and kind == 6 else value
    )
    [answer] = told(one, MessageId.PARAM_SET, name, sent, kind)
    assert one.value(name) == in_force
    assert answer[0] == name
    assert answer == told(one, MessageId.PARAM_REQUEST_READ, name, -1)[0]


@pytest.mark.parametrize("profile", ["ardupilot", "px4"])
@pytest.mark.parametrize("name", [name for name in shipped_vehicles() if name != "qdrone2-recorded"])
def test_the_geometry_that_is_told_is_the_vehicles(profile: str, name: str) -> None:
    dialect, vehicle = dialect_named(profile), vehicle_named(name)
    one = Parameters(dialect.parameters_of(vehicle), dialect.encoding)
    sent = [
        Encoder(*PLANT).encode(MessageId.PARAM_VALUE, *fields) for fields in told(one, MessageId.PARAM_REQUEST_LIST)
    ]
    frames = [Decoder().feed(data, 0)[0] for data in sent]
    found = layout_from_parameters(parameters_in(frames, Maker.PX4 if profile == "px4" else Maker.ARDUPILOTMEGA))
    own = airframe_of(vehicle, name).layout
    assert own is not None
    if profile == "ardupilot" and name == "qdrone2":  # the thesis counts its rotors in an order that ArduPilot has not
        assert found.layout is None
    else:
        assert found.layout is not None
        assert found.layout.alike(own)
