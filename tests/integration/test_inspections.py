"""A declared fault after whatever ends the flight, to the end: told, kept over restarts, closed by who looked only."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle, received
from test_daemon_virtual import US, field, of
from typer.testing import CliRunner

from detector.config import Settings
from mavdiag import inspections
from mavdiag.baseline import Baseline
from mavdiag.cli import app
from mavdiag.decision.alarm import NOTHING_SEEN
from mavdiag.decision.diagnosis import Change, RotorSpan, Stage
from mavdiag.errors import UsageError
from mavdiag.inspections import Inspections
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.monitors.base import FaultKind

STATION = Encoder(255, Component.MISSIONPLANNER)
TEXT = "PROP rotor unknown: inspect before flight"
CLOSED = "PROP rotor unknown: inspection acknowledged"
Benches = Callable[..., Bench]


@pytest.fixture
def benches(tmp_path: Path) -> Iterator[Benches]:
    made: list[Bench] = []

    def make(baseline: Baseline | None = None) -> Bench:
        settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
        journal = tmp_path / "journal.jsonl"
        if made and made[-1].file is not None:
            made[-1].file.close()  # the end of the process before gives its lock back
        made.append(
            Bench(
                settings,
                baseline or baseline_for(),
                vehicles=[MadeVehicle(1)],
                links_behind=1,
                journal=journal,
                inspections=Inspections(journal, print),
            )
        )
        return made[-1]

    yield make
    made.pop().close()
    for end in (end for bench in made for end in bench.open):
        end.close()


def texts(bench: Bench) -> list[str]:
    return [one.text("text") for one in of(received(bench.behind[0]), MessageId.STATUSTEXT)]


def flown(bench: Bench, *, faulty: bool) -> Bench:
    """A flight, with a fault or without, and its landing."""
    bench.run(4.0)
    bench.vehicles[0].turning = 0.5 if faulty else 0.0
    bench.run(4.0)
    bench.vehicles[0].turning, bench.vehicles[0].armed = 0.0, False
    bench.run(4.0)
    return bench


def stage(bench: Bench) -> Stage:
    return bench.daemon.fleet.vehicles[1].session.diagnosis.stage


def acknowledgement() -> bytes:
    return STATION.encode(MessageId.COMMAND_LONG, *US, MavCmd.USER_1, 0, *[0.0] * 7)


def answers(bench: Bench, frames: list[object]) -> list[int]:
    return [int(str(field(one, "result"))) for one in of(frames, MessageId.COMMAND_ACK)]  # type: ignore[arg-type]


def test_a_landing_opens_an_inspection_that_a_restart_keeps_and_the_command_closes(
    benches: Benches, tmp_path: Path
) -> None:
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

    third = flown(benches(), faulty=False)
    assert TEXT not in texts(third)
    run = CliRunner().invoke(app, ["ack", str(tmp_path / "journal.jsonl")])
    assert isinstance(run.exception, UsageError)
    assert str(run.exception).endswith("no inspection is open")


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
    bench.far.send(acknowledgement())
    bench.run(0.2)
    assert answers(bench, received(bench.far)) == [MavResult.DENIED]  # type: ignore[arg-type]
    assert stage(bench) is Stage.INSPECT
    assert any("it may be forged" in line for line in bench.host.lines)
    for result in (MavResult.ACCEPTED, MavResult.FAILED):  # the second one finds nothing open
        received(bench.behind[0])
        bench.behind[0].send(acknowledgement())
        bench.run(0.2)
        assert answers(bench, received(bench.behind[0])) == [result]  # type: ignore[arg-type]
    assert stage(bench) is not Stage.INSPECT
    assert any("acknowledged by 255/190" in line for line in bench.host.lines)


def change(stage: Stage, *rotors: int) -> Change:
    spans = tuple(RotorSpan(rotor, 0) for rotor in rotors)
    given = (stage, "made", 0, None, None, "", 0.0, 0.0, rotors[-1] if rotors else None, None, None, None)
    return Change(*given, kind=FaultKind.PROPELLER, rotors=spans)


def test_only_a_newer_set_of_propellers_closes_an_inspection_by_itself(tmp_path: Path) -> None:
    journal = tmp_path / "j"
    kept = Inspections(journal, print)
    kept.take(7, change(Stage.FAULT, 1, 4), "digest", 2, "2026-01-01T00:00:00+00:00")
    kept.take(8, change(Stage.INSPECT), "digest", 0, "2026-01-01T00:00:00+00:00")
    again = Inspections(journal, print)
    for propellers in (None, 0, 2):
        held = again.held(7, propellers)
        assert (held.stage, held.rotor, [one.rotor for one in held.rotors]) == (Stage.INSPECT, 4, [1, 4])
    assert again.held(9, 0) == NOTHING_SEEN
    assert again.held(7, 3) == NOTHING_SEEN
    assert inspections.read_open(journal).keys() == {8}
    again.take(8, change(Stage.NOT_JUDGED), "digest", 0, "")
    assert inspections.read_open(journal) == {}


def test_an_acknowledgement_without_a_running_detector_is_taken_up_at_its_start(tmp_path: Path) -> None:
    journal = tmp_path / "j"
    for vehicle in (1, 2):
        Inspections(journal, print).take(vehicle, change(Stage.INSPECT, vehicle), "", 0, "")
    run = CliRunner().invoke(app, ["ack", str(journal)])
    assert isinstance(run.exception, UsageError)
    assert "choose one with --vehicle: vehicle 1: motor 1 (propeller fault, " in str(run.exception)
    run = CliRunner().invoke(app, ["ack", str(journal), "--vehicle", "2", "--by", "Bo"])
    assert run.exit_code == 0, run.output
    kept = Inspections(journal, print)
    assert kept.acknowledged() == [(2, "mavdiag ack by Bo")]
    assert kept.acknowledged() == []
