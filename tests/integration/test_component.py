"""A declared fault after whatever ends the flight: told, kept, acted on, and closed by who looked only; parameters."""

import errno
import itertools
import json
import math
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock, patch

import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle, received
from reactions import USUAL, fly
from test_attacks import LOITER, Attacked
from test_daemon_virtual import STATION, US, of
from typer.testing import CliRunner

from detector.component import PARAMETERS
from detector.config import Settings
from mavdiag import __version__, inspections
from mavdiag.cli import app
from mavdiag.decision.alarm import NOTHING_SEEN
from mavdiag.decision.diagnosis import Change, RotorSpan, Stage
from mavdiag.errors import BaselineError, UsageError
from mavdiag.inspections import Inspections
from mavdiag.link.codec import Frame
from mavdiag.link.keys import RETRY_S
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId, Severity
from mavdiag.link.vehicles import REQUESTS_MAX
from mavdiag.monitors.base import FaultKind

TEXT = "PROP rotor unknown: inspect before flight"
CLOSED = "PROP rotor unknown: inspection acknowledged"
Benches = Callable[..., Attacked]
ACK, *REPEATED = (STATION.encode(MessageId.COMMAND_LONG, *US, MavCmd.USER_1, n, *[0.0] * 7) for n in (0, 1, 1, 1))
REAL32, INT8 = 9, 2
CRAFT = replace(USUAL, rate_hz=200.0)  # of its link


@pytest.fixture
def benches(tmp_path: Path) -> Iterator[Benches]:
    made: list[Attacked] = []

    def make(table: str = "") -> Attacked:
        settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"), on_fault=table)
        journal = tmp_path / "journal.jsonl"
        if made and made[-1].file is not None:
            made[-1].file.close()  # the end of the process before gives its lock back
        kept: dict[str, Any] = {"journal": journal, "inspections": Inspections(journal, print)}
        made.append(Attacked(settings, baseline_for(), vehicles=[MadeVehicle(1)], links_behind=1, **kept))
        return made[-1]

    yield make
    made.pop().close()
    for end in (end for bench in made for end in bench.open):
        end.close()


def texts(bench: Bench) -> list[str]:
    return [one.text("text") for one in of(received(bench.behind[0]), MessageId.STATUSTEXT)]


def flown(bench: Bench, *, faulty: bool) -> Bench:
    bench.run(4.0)
    bench.vehicles[0].turning = 0.5 if faulty else 0.0
    bench.run(4.0)
    bench.vehicles[0].turning, bench.vehicles[0].armed = 0.0, False
    bench.run(4.0)
    return bench


def stage(bench: Bench) -> Stage:
    return bench.daemon.fleet.vehicles[1].session.diagnosis.stage


def answers(frames: list[Frame]) -> list[int]:
    return [one.value("result") for one in of(frames, MessageId.COMMAND_ACK)]


def test_a_landing_opens_an_inspection_that_stays_until_the_command_closes_it(benches: Benches, tmp_path: Path) -> None:
    bench = flown(benches(), faulty=True)
    assert stage(bench) is Stage.INSPECT
    said = texts(bench)
    assert TEXT in said
    assert not [one for one in said if "clear" in one or "over" in one]
    bench.daemon.end()

    again = flown(benches(), faulty=False)
    assert stage(again) is Stage.INSPECT
    assert TEXT in texts(again)
    run = CliRunner().invoke(app, ["ack", str(tmp_path / "journal.jsonl"), "--by", "Ann"])
    assert run.exit_code == 0, run.output
    assert "vehicle 1: rotor unknown" in run.output
    again.run(2.0)
    assert stage(again) is not Stage.INSPECT
    assert CLOSED in texts(again)
    lines = [json.loads(one) for one in (tmp_path / "journal.jsonl").read_text().splitlines()]
    notes = [one["text"] for one in lines if one["kind"] == "note" and "acknowledged" in one["text"]]
    assert notes == ["inspection of rotor unknown acknowledged by mavdiag ack by Ann"]
    stages = [one["stage"] for one in lines if one["kind"] == "stage"]
    assert [stages[i] for i in range(len(stages)) if stages[i] in ("fault", "inspect")][-2:] == ["fault", "inspect"]
    assert stages.index("not judged") > stages.index("inspect")
    again.daemon.end()

    assert TEXT not in texts(flown(benches(), faulty=False))
    run = CliRunner().invoke(app, ["ack", str(tmp_path / "journal.jsonl")])
    assert isinstance(run.exception, UsageError)
    assert str(run.exception).endswith("no inspection is open")


def test_a_pause_of_the_link_withdraws_no_fault_but_a_landing_in_it_does(benches: Benches) -> None:
    """A pause of 1.2 s made it an inspection in flight, and ended the reaction."""
    bench = benches()
    (vehicle,), vehicle.turning = bench.vehicles, 0.5
    bench.run(8.0)
    for lands in (False, True):
        bench.vehicles, vehicle.armed = [], not lands
        bench.run(1.5)
        bench.vehicles, vehicle.sent = [vehicle], vehicle.sent + 150
        bench.run(3.0)
        assert stage(bench) is (Stage.INSPECT if lands else Stage.FAULT)


def test_a_daemon_that_dies_in_flight_leaves_the_inspection_open(benches: Benches) -> None:
    bench = benches()
    bench.run(4.0)
    bench.vehicles[0].turning = 0.5
    bench.run(4.0)
    assert stage(bench) is Stage.FAULT
    again = flown(benches(), faulty=False)  # the first one never ended
    assert TEXT in texts(again)


def test_a_ground_station_behind_acknowledges_and_a_stranger_on_an_unsigned_link_does_not(benches: Benches) -> None:
    bench = flown(benches(), faulty=True)
    received(bench.far)
    bench.far.send(ACK)
    bench.run(0.2)
    assert answers(received(bench.far)) == [MavResult.DENIED]
    assert stage(bench) is Stage.INSPECT
    assert any("it may be forged" in line for line in bench.host.lines)
    yes, no = MavResult.ACCEPTED, MavResult.FAILED  # a new one finds nothing open
    for sent, result in zip((*REPEATED[:2], ACK, REPEATED[2]), (yes, yes, no, yes), strict=True):
        received(bench.behind[0])
        bench.behind[0].send(sent)
        bench.run(0.2)
        assert answers(received(bench.behind[0])) == [result]
    assert stage(bench) is not Stage.INSPECT
    assert any("acknowledged by 255/190" in line for line in bench.host.lines)


def test_a_look_takes_so_much_of_a_link_behind_and_passes_it_unchanged(bench: Bench) -> None:
    """30 datagrams of heartbeats held the loop up for 17 s."""
    unknown = 4500 * bytes((0xFD, 1, 0, 0, 7, 255, 190, 0xEE, 0xEE, 0, 7, 1, 2))
    one = b"".join(STATION.encode(MessageId.PARAM_REQUEST_READ, *US, "PROP_ACK", -1) for _ in range(20)) + unknown
    for _ in range(3):
        bench.behind[0].send(one)
    bench.run(0.04)
    assert 2 * one in b"".join(data for data, _ in bench.far.receive(0.0))
    assert bench.daemon.figures().links[1].traffic.overflowed == 1
    assert len(of(received(bench.behind[0]), MessageId.PARAM_VALUE)) == REQUESTS_MAX


def test_an_inspection_is_written_after_the_alert_was_sent_and_when_the_disk_has_room_again(
    benches: Benches, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bench, sent = benches(), list[list[str]]()

    def full(path: Path, _: str) -> None:
        sent.append(texts(bench))
        raise UsageError(f"{path}: no space")

    with monkeypatch.context() as context:
        context.setattr(inspections, "write_atomically", full)
        flown(bench, faulty=True)
    assert any(one.startswith("PROP FAULT") for one in sent[0])
    assert len(sent) == 1  # of the seconds that passed
    bench.run(RETRY_S)
    assert inspections.read_open(tmp_path / "journal.jsonl").keys() == {1}
    assert capsys.readouterr().out.count("inspections are") == 2  # that it failed, and that it works again


def change(stage: Stage, *rotors: int) -> Change:
    spans = tuple(RotorSpan(rotor, 0) for rotor in rotors)
    given = (stage, "made", 0, None, None, "", 0.0, 0.0, rotors[-1] if rotors else None, None, None, None)
    return Change(*given, kind=FaultKind.PROPELLER, rotors=spans)


def test_only_a_newer_set_of_propellers_closes_an_inspection_by_itself(tmp_path: Path) -> None:
    journal = tmp_path / "j"
    kept = Inspections(journal, print)
    kept.take(7, change(Stage.FAULT, 1, 4), "digest", 2, "2026-01-01T00:00:00+00:00")
    kept.take(8, change(Stage.INSPECT), "digest", 0, "2026-01-01T00:00:00+00:00")
    kept.flush()
    again = Inspections(journal, print)
    for propellers in (None, 0, 2):
        held = again.held(7, propellers)
        assert (held.stage, held.rotor, [one.rotor for one in held.rotors]) == (Stage.INSPECT, 4, [1, 4])
    assert again.held(9, 0) == again.held(7, 3) == NOTHING_SEEN
    again.flush()
    assert inspections.read_open(journal).keys() == {8}
    again.take(8, change(Stage.NOT_JUDGED), "digest", 0, "")
    again.flush()
    assert inspections.read_open(journal) == {}


def test_an_acknowledgement_without_a_running_detector_is_taken_up_at_its_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = CliRunner().invoke(app, ["ack", str(tmp_path / "none")])
    assert "no such file; name the detector's --journal" in str(run.exception)
    journal = tmp_path / "j"
    kept = Inspections(journal, print)
    for vehicle in (1, 2):
        kept.take(vehicle, change(Stage.INSPECT, vehicle), "", 0, "")
    kept.flush()
    run = CliRunner().invoke(app, ["ack", str(journal)])
    assert isinstance(run.exception, UsageError)
    assert "choose one with --vehicle: vehicle 1: motor 1 (propeller fault, " in str(run.exception)
    for whose, told in (((), "handed over; a detector"), (("--by", "B\udcff"), "handed over before, but no")):
        run = CliRunner().invoke(app, ["ack", str(journal), "--vehicle", "2", *whose], env={"LOGNAME": None})
        assert (run.exit_code, told in run.output) == (0, True), run.output
    kept = Inspections(journal, warn := Mock())
    for call in ("exists", "unlink"):  # an acknowledgement that stayed would close the next inspection, too
        with monkeypatch.context() as context:
            context.setattr(Path, call, Mock(side_effect=OSError(errno.EIO, call)))
            assert kept.acknowledged() == kept.acknowledged() == []
    assert (kept.acknowledged(), kept.acknowledged()) == ([(2, "mavdiag ack by B\\udcff")], [])
    assert warn.call_count == 3  # of both vehicles' files, then of the one that is there
    assert (inspections.ask(journal, 1, "one who came too late")[0].vehicle, kept.close(1)) == (1, True)
    kept.take(1, change(Stage.FAULT, 1), "", 0, "")
    assert kept.acknowledged() == []


@pytest.fixture
def bench(benches: Benches) -> Bench:
    made = benches()
    made.run(5.0)
    return made


def asked(bench: Bench, frame: bytes, *, behind: bool = True) -> list[Frame]:
    end = bench.behind[0] if behind else bench.far
    received(end)
    end.send(frame)
    bench.run(0.2)
    return [one for one in received(end) if (one.sysid, one.compid) == US]


def values(frames: list[Frame]) -> dict[object, object]:
    return {one.text("param_id"): one.value("param_value") for one in of(frames, MessageId.PARAM_VALUE)}


def setting(name: str, value: float, kind: int = REAL32) -> bytes:
    return STATION.encode(MessageId.PARAM_SET, *US, name, value, kind)


def on_the_ground(bench: Bench) -> None:
    bench.vehicles[0].armed = False
    bench.run(4.0)


@pytest.mark.parametrize("behind", [True, False])
def test_everybody_reads_the_parameters_and_pymavlink_agrees(bench: Bench, behind: bool) -> None:
    found = asked(bench, STATION.encode(MessageId.PARAM_REQUEST_LIST, *US), behind=behind)
    assert values(found) == {"PROP_SCALE": 1.0, "PROP_TEXTS": 30.0, "PROP_ACK": 0.0}
    assert [one.value("param_index") for one in of(found, MessageId.PARAM_VALUE)] == [0, 1, 2]
    assert {one.value("param_count") for one in of(found, MessageId.PARAM_VALUE)} == {len(PARAMETERS)}
    for component, count in ((Component.ALL, 3), (Component.AUTOPILOT1, 0)):
        other = asked(bench, STATION.encode(MessageId.PARAM_REQUEST_LIST, 1, component), behind=behind)
        assert len(of(other, MessageId.PARAM_VALUE)) == count
    for name, index, right in (("PROP_TEXTS", -1, "PROP_TEXTS"), ("", 0, "PROP_SCALE")):
        found = asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, name, index), behind=behind)
        assert list(values(found)) == [right]
    for name, index in (("PROP_NONE", -1), ("", 3)):
        assert not values(asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, name, index), behind=behind))
    [answer] = of(asked(bench, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, "", 0)), MessageId.PARAM_VALUE)
    fields = dialect.mavlink_map[MessageId.PARAM_VALUE].unpacker.unpack(answer.payload)
    assert fields == (1.0, 3, 0, b"PROP_SCALE".ljust(16, b"\0"), REAL32)


def test_texts_are_set_in_flight_and_the_scale_on_the_ground(bench: Bench, tmp_path: Path) -> None:
    session = bench.daemon.fleet.vehicles[1].session
    assert values(asked(bench, setting("PROP_TEXTS", 12.0))) == {"PROP_TEXTS": 12.0}
    assert session.settings.texts_per_minute == 12
    assert values(asked(bench, setting("PROP_SCALE", 2.0))) == {"PROP_SCALE": 1.0}
    on_the_ground(bench)
    with patch("detector.session.chain_for", side_effect=BaselineError("no monitor can judge")):
        assert values(asked(bench, setting("PROP_SCALE", 4.0))) == {"PROP_SCALE": 1.0}
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
    assert answers(found) == [MavResult.ACCEPTED]
    [told] = [one for one in found if one.msgid == msgid]
    if msgid == MessageId.AUTOPILOT_VERSION:
        number = told.value("flight_sw_version")
        assert ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8)) == __version__
    else:
        names = [told.text(name) for name in ("vendor_name", "model_name", "software_version")]
        assert names == ["mavdiag", "propeller fault detector", __version__]
    nothing = asked(bench, STATION.encode(MessageId.COMMAND_LONG, *US, MavCmd.REQUEST_MESSAGE, 0, math.nan))
    assert answers(nothing) == [MavResult.UNSUPPORTED]


def reacting(benches: Benches) -> Attacked:
    bench = benches("fault after 6 s: rtl")
    bench.vehicles[0].custom_mode = LOITER
    bench.fly(5.0)
    received(bench.far)
    return bench


def damaged(bench: Attacked, seconds: float) -> None:
    bench.vehicles[0].turning = 0.5
    bench.fly(seconds)


def commanded(bench: Attacked) -> list[Frame]:
    frames = [one for one in of(received(bench.far), MessageId.COMMAND_LONG) if (one.sysid, one.compid) == US]
    return [frame for frame in frames if frame.value("command") != MavCmd.SET_MESSAGE_INTERVAL]


def noted(tmp_path: Path) -> list[str]:
    lines = map(json.loads, (tmp_path / "journal.jsonl").read_text().splitlines())
    return [line["text"] for line in lines if line["kind"] == "note" and "on fault" in line["text"]]


def test_a_fault_brings_one_command_and_every_step_is_in_the_journal(benches: Benches, tmp_path: Path) -> None:
    bench = reacting(benches)
    damaged(bench, 7.0)
    [order] = commanded(bench)
    assert (order.sysid, order.compid) == US
    told = order.numbers("target_system", "target_component", "command", "confirmation")
    assert told == (1, Component.AUTOPILOT1, MavCmd.NAV_RETURN_TO_LAUNCH, 0)
    accepted = (MavCmd.NAV_RETURN_TO_LAUNCH, MavResult.ACCEPTED, 0, 0, *US)
    bench.far.send(bench.vehicles[0].encoder.encode(MessageId.COMMAND_ACK, *accepted))
    bench.fly(12.0)
    assert commanded(bench) == []
    found, *steps = noted(tmp_path)
    assert found.startswith("on fault: fault after 6 s: rtl: propeller fault: ")
    assert [step.split(": ")[3:] for step in steps] == [
        ["counting -> announced", "its time is near"],
        ["announced -> asked", "its time has come"],
        ["asked -> over", "the autopilot took it"],
    ]
    said = [one for one in of(received(bench.behind[0]), MessageId.STATUSTEXT) if "rtl" in one.text("text")]
    words = ("PROP rtl in 5 s unless stick/mode/ack", "PROP rtl commanded: fault, rotor unknown")
    assert [(*one.numbers("severity"), one.text("text")) for one in said] == [(Severity.CRITICAL, one) for one in words]


@pytest.mark.parametrize("how", ["ack", "stick", "mode", "mavdiag ack"])
def test_it_is_called_off_by_a_link_behind_or_the_vehicles_mode(benches: Benches, tmp_path: Path, how: str) -> None:
    bench = reacting(benches)
    bench.behind[0].send(STATION.encode(MessageId.MANUAL_CONTROL, 1, 0, 0, 500, 0, 0))
    damaged(bench, 4.0)
    assert [one for one in noted(tmp_path) if "announced" in one]
    if how == "ack":
        bench.behind[0].send(ACK)
    elif how == "stick":
        bench.behind[0].send(STATION.encode(MessageId.MANUAL_CONTROL, 1, 0, -300, 500, 0, 0))
    elif how == "mode":
        bench.vehicles[0].custom_mode = 16
    else:
        run = CliRunner().invoke(app, ["ack", str(tmp_path / "journal.jsonl"), "--by", "Ann"])
        assert run.exit_code == 0, run.output
    bench.fly(12.0)
    assert commanded(bench) == []
    assert [one for one in noted(tmp_path) if "announced -> over: called off" in one]
    assert answers(received(bench.behind[0])) == [MavResult.ACCEPTED] * (how == "ack")


def test_the_page_acknowledges_open_inspections_and_calls_nothing_off(benches: Benches, tmp_path: Path) -> None:
    bench, pressed = reacting(benches), [[1, 8, 77]]
    damaged(bench, 4.0)
    bench.daemon._inspections.take(8, change(Stage.INSPECT), "", 0, "")  # kept from an earlier flight
    bench.daemon._web = Mock(acknowledged=lambda: pressed.pop() if pressed else [])
    bench.fly(5.0)
    assert commanded(bench)
    assert re.findall(r"inspection of vehicle (\d+) acknowledged", (tmp_path / "journal.jsonl").read_text()) == ["8"]


def test_a_stranger_on_an_unsigned_link_does_not_call_it_off(benches: Benches) -> None:
    bench = reacting(benches)
    damaged(bench, 3.0)
    sticks = (STATION.encode(MessageId.MANUAL_CONTROL, 1, 1000 * (-1) ** k, 0, 500, 0, 0) for k in itertools.count())
    bench.fly(5.0, ([ACK, stick] for stick in sticks))
    assert len(commanded(bench)) == 2


def test_a_lost_link_ends_it_until_the_fault_is_found_again(benches: Benches) -> None:
    bench = reacting(benches)
    damaged(bench, 2.0)
    (vehicle,), bench.vehicles = bench.vehicles, []
    bench.fly(10.0)
    assert commanded(bench) == []
    bench.vehicles = [vehicle]
    vehicle.sent += 1000
    bench.fly(20.0)
    assert len(commanded(bench)) == 2


def test_a_mission_with_a_crack_is_flown_home_after_the_delay_and_a_call_off_lets_it_go_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("reactions.TAUGHT", 2)  # flights to learn from are half of the time that this takes
    monkeypatch.setattr("reactions.LEARN_S", 40.0)
    monkeypatch.setattr("reactions.ONSET_S", 17.0)
    flown = fly("mission", 100, "F2/SV3", craft=CRAFT)
    assert (flown.commands, flown.announced, flown.down) == (["rtl"], True, True)
    assert flown.late_s is not None
    assert -0.01 <= flown.late_s <= 0.5
    left = fly("mission", 101, "F2/SV3", craft=CRAFT, call="stick", until_s=32.0)
    assert (left.called_off, left.commands, left.down) == (True, [], False)
    flown = fly("mission", 102, craft=CRAFT, until_s=32.0)
    assert (flown.commands, flown.announced, flown.declared_s) == ([], False, None)
    assert flown.judged > 0.5
