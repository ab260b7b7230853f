"""The detector as component 191: its parameters and version, read by everybody and set by who is trusted."""

import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle, received
from test_daemon_virtual import STATION, US, field, of

from detector.component import CHANGES
from detector.config import Settings
from mavdiag import __version__
from mavdiag.decision.diagnosis import Stage
from mavdiag.link.codec import Frame
from mavdiag.link.messages import MavCmd, MavResult, MessageId

REAL32, INT8 = 9, 2


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
    made = Bench(
        settings, baseline_for(), vehicles=[MadeVehicle(1)], links_behind=1, journal=tmp_path / "journal.jsonl"
    )
    made.run(5.0)
    yield made
    made.close()


def asked(bench: Bench, frame: bytes, *, behind: bool = True) -> list[Frame]:
    """What component 191 answers on the link that it is asked on."""
    end = bench.behind[0] if behind else bench.far
    received(end)
    end.send(frame)
    bench.run(0.2)
    return [one for one in received(end) if (one.sysid, one.compid) == US]


def values(frames: list[Frame]) -> dict[object, object]:
    return {field(one, "param_id"): field(one, "param_value") for one in of(frames, MessageId.PARAM_VALUE)}


def setting(name: str, value: float, kind: int = REAL32) -> bytes:
    return STATION.encode(MessageId.PARAM_SET, *US, name, value, kind)


def on_the_ground(bench: Bench) -> None:
    bench.vehicles[0].armed = False
    bench.run(4.0)


@pytest.mark.parametrize("behind", [True, False])
def test_everybody_reads_the_parameters_and_pymavlink_agrees(bench: Bench, behind: bool) -> None:
    found = asked(bench, STATION.encode(MessageId.PARAM_REQUEST_LIST, *US), behind=behind)
    assert values(found) == {"PROP_SCALE": 1.0, "PROP_TEXTS": 30.0, "PROP_ACK": 0.0}
    assert [field(one, "param_index") for one in of(found, MessageId.PARAM_VALUE)] == [0, 1, 2]
    assert {field(one, "param_count") for one in of(found, MessageId.PARAM_VALUE)} == {len(CHANGES)}
    for name, index, right in (("PROP_TEXTS", -1, "PROP_TEXTS"), ("", 0, "PROP_SCALE")):
        found = asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, name, index), behind=behind)
        assert list(values(found)) == [right]
    for name, index in (("PROP_NONE", -1), ("", 3)):
        assert not values(asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, name, index), behind=behind))
    [answer] = of(asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, "", 0)), MessageId.PARAM_VALUE)
    fields = dialect.mavlink_map[MessageId.PARAM_VALUE].unpacker.unpack(answer.payload)
    assert fields == (1.0, 3, 0, b"PROP_SCALE".ljust(16, b"\0"), REAL32)


@pytest.mark.parametrize("component", [0, 1])
def test_what_is_asked_of_others_is_not_answered(bench: Bench, component: int) -> None:
    frame = STATION.encode(MessageId.PARAM_REQUEST_LIST, 1, component)
    assert of(asked(bench, frame), MessageId.PARAM_VALUE) == []


def test_texts_are_set_in_flight_and_the_scale_on_the_ground(bench: Bench, tmp_path: Path) -> None:
    session = bench.daemon.fleet.vehicles[1].session
    assert values(asked(bench, setting("PROP_TEXTS", 12.0))) == {"PROP_TEXTS": 12.0}
    assert session.settings.texts_per_minute == 12
    assert values(asked(bench, setting("PROP_SCALE", 2.0))) == {"PROP_SCALE": 1.0}
    on_the_ground(bench)
    assert values(asked(bench, setting("PROP_SCALE", 2.0))) == {"PROP_SCALE": 2.0}
    bench.vehicles[0].armed = True
    bench.run(5.0)
    assert session.judge is not None
    [entry] = session.judge.baseline.monitors
    assert session.judge.chain.slots[0].threshold == pytest.approx(2.0 * entry.threshold.value)
    bench.vehicles[0].turning = 0.5
    bench.run(3.0)
    assert session.diagnosis.stage is Stage.FAULT
    lines = map(json.loads, (tmp_path / "journal.jsonl").read_text().splitlines())
    notes = [line["text"] for line in lines if line["kind"] == "note"]
    assert "PROP_TEXTS = 12 by 255/190" in notes
    assert "PROP_SCALE = 2 of 255/190: refused, the vehicle is armed" in notes


def test_a_scale_that_is_set_keeps_an_open_inspection_and_a_parameter_closes_it(bench: Bench) -> None:
    session = bench.daemon.fleet.vehicles[1].session
    assert values(asked(bench, setting("PROP_ACK", 1.0))) == {"PROP_ACK": 0.0}
    bench.vehicles[0].turning = 0.5
    bench.run(4.0)
    on_the_ground(bench)
    assert session.diagnosis.stage is Stage.INSPECT
    asked(bench, setting("PROP_SCALE", 1.5))
    bench.run(4.0)
    assert session.diagnosis.stage is Stage.INSPECT
    assert values(asked(bench, setting("PROP_ACK", 0.0))) == {"PROP_ACK": 0.0}
    assert session.diagnosis.stage is Stage.INSPECT
    assert values(asked(bench, setting("PROP_ACK", 1.0))) == {"PROP_ACK": 1.0}
    assert session.diagnosis.stage is not Stage.INSPECT
    assert values(asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, "PROP_ACK", -1))) == {"PROP_ACK": 0.0}


@pytest.mark.parametrize(
    ("name", "value", "kind", "told"),
    [
        ("PROP_SCALE", 0.1, REAL32, {"PROP_SCALE": 1.0}),
        ("PROP_TEXTS", 1000.0, REAL32, {"PROP_TEXTS": 30.0}),
        ("PROP_TEXTS", math.nan, REAL32, {"PROP_TEXTS": 30.0}),
        ("PROP_TEXTS", struct.unpack("<f", struct.pack("<i", 12))[0], INT8, {"PROP_TEXTS": 30.0}),
        ("PROP_NONE", 1.0, REAL32, {}),
    ],
)
def test_what_cannot_be_set_is_answered_with_the_value_in_force(
    bench: Bench, name: str, value: float, kind: int, told: dict[object, object]
) -> None:
    on_the_ground(bench)
    assert values(asked(bench, setting(name, value, kind))) == told


def test_who_is_not_trusted_sets_nothing(bench: Bench, tmp_path: Path) -> None:
    on_the_ground(bench)
    for _ in range(3):
        assert values(asked(bench, setting("PROP_SCALE", 4.0), behind=False)) == {"PROP_SCALE": 1.0}
    told = (tmp_path / "journal.jsonl").read_text()
    assert told.count("a parameter was set by 255/190 on a link that is not signed: refused") == 1


@pytest.mark.parametrize(
    ("command", "msgid"),
    [
        ((MavCmd.REQUEST_MESSAGE, 0, 148), MessageId.AUTOPILOT_VERSION),
        ((MavCmd.REQUEST_AUTOPILOT_CAPABILITIES, 0, 1), MessageId.AUTOPILOT_VERSION),
        ((MavCmd.REQUEST_MESSAGE, 0, 396), MessageId.COMPONENT_INFORMATION_BASIC),
    ],
)
def test_its_version_is_told(bench: Bench, command: tuple[float, ...], msgid: int) -> None:
    found = asked(bench, STATION.encode(MessageId.COMMAND_LONG, *US, *command))
    assert [field(one, "result") for one in of(found, MessageId.COMMAND_ACK)] == [MavResult.ACCEPTED]
    [told] = [one for one in found if one.msgid == msgid]
    if msgid == MessageId.AUTOPILOT_VERSION:
        number = field(told, "flight_sw_version")
        assert isinstance(number, int)
        assert ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8)) == __version__
    else:
        assert [field(told, name) for name in ("vendor_name", "model_name", "software_version")] == [
            *("mavdiag", "propeller fault detector", __version__)
        ]
    nothing = asked(bench, STATION.encode(MessageId.COMMAND_LONG, *US, MavCmd.REQUEST_MESSAGE, 0, math.nan))
    assert [field(one, "result") for one in of(nothing, MessageId.COMMAND_ACK)] == [MavResult.UNSUPPORTED]
