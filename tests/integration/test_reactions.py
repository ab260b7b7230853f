"""Reactions over the wire: the command, its answer, what calls it off, and who neither causes nor hinders one."""

import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from loop_plant import HIL_HZ, LoopPlant
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle, received
from reactions import IN_LOOP, PROFILE, USUAL, Station, fly
from test_attacks import UDP_IN, Attacked
from test_daemon_virtual import STATION, US, field, of
from typer.testing import CliRunner
from virtual_flight import VirtualFlight

from detector.config import Settings
from mavdiag.cli import app
from mavdiag.inspections import Inspections
from mavdiag.link.codec import Encoder, Frame
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId, Severity
from sitl_plant.plant import Plant, PlantSamples

LOITER = 5
CRAFT = replace(USUAL, rate_hz=200.0)  # of its link
ACKNOWLEDGEMENT = STATION.encode(MessageId.COMMAND_LONG, *US, MavCmd.USER_1, 0, *[0.0] * 7)
Benches = Callable[..., Attacked]


@pytest.fixture
def benches(tmp_path: Path) -> Iterator[Benches]:
    made: list[Attacked] = []

    def make(table: str = "fault after 6 s: rtl") -> Attacked:
        vehicle, journal = MadeVehicle(1), tmp_path / "journal.jsonl"
        vehicle.custom_mode = LOITER
        bench = Attacked(
            Settings(connect=UDP_IN, baseline=Path("b.json"), on_fault=table),
            baseline=baseline_for(),
            vehicles=[vehicle],
            links_behind=1,
            journal=journal,
            inspections=Inspections(journal, print),
        )
        made.append(bench)
        bench.fly(5.0)
        received(bench.far)
        return bench

    yield make
    for bench in made:
        bench.close()


def damaged(bench: Attacked, seconds: float) -> None:
    bench.vehicles[0].turning = 0.5
    bench.fly(seconds)


def commanded(bench: Attacked) -> list[Frame]:
    frames = [one for one in of(received(bench.far), MessageId.COMMAND_LONG) if (one.sysid, one.compid) == US]
    return [frame for frame in frames if field(frame, "command") != MavCmd.SET_MESSAGE_INTERVAL]


def answer(bench: Attacked, sender: Encoder, target: tuple[int, int] = US) -> bytes:
    return sender.encode(MessageId.COMMAND_ACK, MavCmd.NAV_RETURN_TO_LAUNCH, MavResult.ACCEPTED, 0, 0, *target)


def noted(tmp_path: Path) -> list[str]:
    lines = map(json.loads, (tmp_path / "journal.jsonl").read_text().splitlines())
    return [line["text"] for line in lines if line["kind"] == "note" and "on fault" in line["text"]]


def test_a_fault_brings_one_command_and_every_step_is_in_the_journal(benches: Benches, tmp_path: Path) -> None:
    bench = benches()
    damaged(bench, 7.0)
    [order] = commanded(bench)
    assert (order.sysid, order.compid) == US
    assert [field(order, name) for name in ("target_system", "target_component", "command", "confirmation")] == [
        *(1, Component.AUTOPILOT1, MavCmd.NAV_RETURN_TO_LAUNCH, 0)
    ]
    bench.far.send(answer(bench, bench.vehicles[0].encoder))
    bench.fly(30.0)
    assert commanded(bench) == []
    found, *steps = noted(tmp_path)
    assert found.startswith("on fault: fault after 6 s: rtl: propeller fault: ")
    assert [step.split(": ")[3:] for step in steps] == [
        ["counting -> announced", "its time is near"],
        ["announced -> asked", "its time has come"],
        ["asked -> over", "the autopilot took it"],
    ]
    said = [one for one in of(received(bench.behind[0]), MessageId.STATUSTEXT) if "rtl" in one.text("text")]
    own = [(*one.numbers("severity"), one.text("text")) for one in said]
    assert own == [
        (Severity.CRITICAL, "PROP rtl in 5 s unless stick/mode/ack"),
        (Severity.CRITICAL, "PROP rtl commanded: fault, rotor unknown"),
    ]


@pytest.mark.parametrize("how", ["ack", "stick", "mode", "mavdiag ack"])
def test_it_is_called_off_by_a_link_behind_or_the_vehicles_mode(benches: Benches, tmp_path: Path, how: str) -> None:
    bench = benches()
    bench.behind[0].send(STATION.encode(MessageId.MANUAL_CONTROL, 1, 0, 0, 500, 0, 0))
    damaged(bench, 4.0)
    assert [one for one in noted(tmp_path) if "announced" in one]
    if how == "ack":
        bench.behind[0].send(ACKNOWLEDGEMENT)
    elif how == "stick":
        bench.behind[0].send(STATION.encode(MessageId.MANUAL_CONTROL, 1, 0, -300, 500, 0, 0))
    elif how == "mode":
        bench.vehicles[0].custom_mode = 16
    else:
        run = CliRunner().invoke(app, ["ack", str(tmp_path / "journal.jsonl"), "--by", "Ann"])
        assert run.exit_code == 0, run.output
    bench.fly(30.0)
    assert commanded(bench) == []
    assert [one for one in noted(tmp_path) if "announced -> over: called off" in one]
    results = [field(one, "result") for one in of(received(bench.behind[0]), MessageId.COMMAND_ACK)]
    assert results == [MavResult.ACCEPTED] * (how == "ack")


def test_a_stranger_on_an_unsigned_link_does_not_call_it_off(benches: Benches) -> None:
    bench = benches()
    damaged(bench, 3.0)
    sticks = (STATION.encode(MessageId.MANUAL_CONTROL, 1, 1000 * (-1) ** k, 0, 500, 0, 0) for k in itertools.count())
    bench.fly(5.0, ([ACKNOWLEDGEMENT, stick] for stick in sticks))
    assert len(commanded(bench)) == 2


def test_a_lost_link_ends_it_until_the_fault_is_found_again(benches: Benches) -> None:
    bench = benches()
    damaged(bench, 4.0)
    (vehicle,), bench.vehicles = bench.vehicles, []
    bench.fly(10.0)
    assert commanded(bench) == []
    bench.vehicles = [vehicle]
    vehicle.sent += 1000
    bench.fly(20.0)
    assert len(commanded(bench)) == 2


def test_a_mission_with_a_crack_is_flown_home_after_the_delay_and_a_call_off_lets_it_go_on() -> None:
    flown = fly("mission", 100, "F2/SV3", craft=CRAFT)
    assert flown.commands == ["rtl"]
    assert flown.announced
    assert flown.late_s is not None
    assert -0.01 <= flown.late_s <= 0.5
    assert flown.down
    left = fly("mission", 101, "F2/SV3", craft=CRAFT, call="stick", until_s=50.0)
    assert left.called_off
    assert left.commands == []
    assert not left.down


def test_a_healthy_mission_is_left_alone() -> None:
    flown = fly("mission", 102, craft=CRAFT, until_s=40.0)
    assert (flown.commands, flown.announced, flown.declared_s) == ([], False, None)
    assert flown.judged > 0.5


def test_a_flight_controller_in_the_loop_obeys_with_a_damaged_propeller_and_stands_upright() -> None:
    station, flown = Station(lambda one: [], place="hover"), list[PlantSamples]()
    home = station.encoder.encode(MessageId.COMMAND_LONG, 1, 1, MavCmd.NAV_RETURN_TO_LAUNCH, 0, *[0.0] * 7)
    station.plan.append((14.0, [home]))
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", learn=1e6))
    flight = VirtualFlight(bench, station)
    flight.fly(
        replace(IN_LOOP.config(7), fault="F3/SV3", rotor=3, onset_s=6.0),
        45.0,
        PROFILE,
        HIL_HZ,
        stop=lambda: flight.t_s > 14.0 and not flown[-1].motors[-1],
        watch=flown.append,
        plant_of=lambda config: cast(Plant, LoopPlant(config)),
    )
    bench.close()
    height_m = [-float(rows.position[-1, 2]) for rows in flown]
    before, after = (
        np.mean([np.diff(rows.gyro[:, :2], axis=0).std() for rows in flown if 0.0 < rows.t_ns[0] * 1e-9 - from_s < 2.0])
        for from_s in (7.0, 12.0)
    )
    assert after > 1.3 * before  # the unbalance shakes it
    assert max(height_m) > 1.5
    end = flown[-1]
    assert not end.motors[-1]
    assert flight.t_s < 45.0
    assert abs(end.position[-1]).max() < 0.3
    assert abs(end.attitude[-1, :2]).max() < 0.1
