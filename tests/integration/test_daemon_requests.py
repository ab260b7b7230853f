"""The whole daemon on a virtual clock: what ground stations may ask of it, and several vehicles on one link."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import Bench, FakeFitter, MadeVehicle, received
from memory_port import MemoryEndpoint

from detector.config import Settings, VehicleSettings
from detector.requests import PARAMETERS
from detector.states import State
from detector.values import LearningFailed
from mavdiag.link.codec import Encoder, Frame, decode_statustext, field_index
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId

UDP_IN = "udpin:127.0.0.1:0"
STATION = Encoder(255, Component.MISSIONPLANNER)
US = (1, Component.ONBOARD_COMPUTER)
Benches = Callable[..., Bench]


@pytest.fixture
def benches() -> Iterator[Benches]:
    made: list[Bench] = []

    def make(settings: Settings, *vehicles: MadeVehicle, **options: object) -> Bench:
        bench = Bench(settings, vehicles=list(vehicles), **options)  # type: ignore[arg-type]  # of several types
        made.append(bench)
        return bench

    yield make
    for bench in made:
        bench.close()


def of(frames: list[Frame], message: MessageId) -> list[Frame]:
    return [frame for frame in frames if frame.msgid == message]


def field(frame: Frame, name: str) -> object:
    value = frame.fields[field_index(frame.msgid, name)]
    return value.partition(b"\0")[0].decode() if isinstance(value, bytes) else value


def shown(frames: list[Frame]) -> list[tuple[object, object]]:
    return [(field(one, "param_id"), field(one, "param_value")) for one in of(frames, MessageId.PARAM_VALUE)]


def judging(**more: object) -> Settings:
    return Settings.model_validate({"connect": UDP_IN, "baseline": Path("b.json"), **more})


def asked(bench: Bench, end: MemoryEndpoint, frame: bytes) -> list[Frame]:
    """What comes back for a request."""
    received(end)
    end.send(frame)
    bench.run(0.1)
    return received(end)


def setting(name: str, value: float) -> bytes:
    return STATION.encode(MessageId.PARAM_SET, *US, name, value, 9)


@pytest.mark.parametrize("component", [Component.ONBOARD_COMPUTER, Component.ALL])
def test_its_parameters_are_listed_to_who_asks_and_as_its_own(benches: Benches, component: int) -> None:
    bench = benches(judging(parameters=True), MadeVehicle(1), baseline=baseline_for(), links_behind=1)
    bench.run(4.0)
    for end in (bench.far, bench.behind[0]):
        frames = of(
            asked(bench, end, STATION.encode(MessageId.PARAM_REQUEST_LIST, 1, component)), MessageId.PARAM_VALUE
        )
        assert [field(one, "param_id") for one in frames] == [one.name for one in PARAMETERS]
        assert [field(one, "param_index") for one in frames] == list(range(len(PARAMETERS)))
        assert {field(one, "param_count") for one in frames} == {len(PARAMETERS)}
        assert {(one.sysid, one.compid) for one in frames} == {US}
        values = dict(shown(frames))
        assert values["MD_THR_SCALE"] == 1.0
        assert values["MD_LEARN_S"] == 0.0
        assert values["MD_GYRO_HZ"] == pytest.approx(100.0)
        assert values["MD_STATE"] == list(State).index(State.MONITORING)


def test_one_is_read_by_name_or_number_and_an_unknown_one_is_not_answered(benches: Benches) -> None:
    bench = benches(judging(parameters=True), MadeVehicle(1), baseline=baseline_for())
    bench.run(4.0)
    for number, name, found in (
        (-1, "MD_THR_SCALE", [("MD_THR_SCALE", 1.0)]),
        (1, "", [("MD_THR_SCALE", 1.0)]),
        (99, "", []),
        (-1, "RATE_P", []),
    ):
        frames = asked(bench, bench.far, STATION.encode(MessageId.PARAM_REQUEST_READ, *US, name, number))
        assert shown(frames) == found


def test_a_larger_scale_silences_a_small_fault_and_the_journal_says_who_set_what(
    benches: Benches, tmp_path: Path
) -> None:
    """The made baseline has an FML of 0.3 s; the rate leaves its margin for as long as the vehicle turns."""
    path, vehicle = tmp_path / "j.jsonl", MadeVehicle(1)
    bench = benches(judging(parameters=True), vehicle, baseline=baseline_for(), journal=path)
    bench.run(4.0)
    assert shown(asked(bench, bench.far, setting("MD_THR_SCALE", 4.0))) == [("MD_THR_SCALE", 4.0)]
    bench.run(8.0)
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
    for turning, span_s, alerts in ((0.5, 0.8, False), (0.0, 3.0, False), (0.5, 3.0, True)):
        received(bench.far)
        vehicle.turning = turning
        bench.run(span_s)
        texts = [decode_statustext(one).text for one in of(received(bench.far), MessageId.STATUSTEXT)]
        assert any("FAULT" in text for text in texts) == alerts
        if alerts:
            lines = [json.loads(line) for line in path.read_text().splitlines()]
            assert {one["threshold"] for one in lines if one["kind"] == "opened"} == {1.2}
    notes = [one["text"] for one in map(json.loads, path.read_text().splitlines()) if one["kind"] == "note"]
    assert "MD_THR_SCALE set from 1 to 4" in notes


@pytest.mark.parametrize(
    ("name", "value", "in_force", "words"),
    [
        ("MD_THR_SCALE", 9.0, 1.0, "MD_THR_SCALE 9 refused: it may be 0.5 to 4"),
        ("MD_THR_SCALE", float("nan"), 1.0, "MD_THR_SCALE nan refused: it may be 0.5 to 4"),
        ("MD_LEARN_S", -1.0, 0.0, "MD_LEARN_S -1 refused: it may be 0 to 3600"),
        ("MD_GYRO_HZ", 5.0, 100.0, "MD_GYRO_HZ 5 refused: it can only be read"),
    ],
)
def test_what_is_out_of_range_is_answered_with_the_value_in_force(
    benches: Benches, name: str, value: float, in_force: float, words: str
) -> None:
    bench = benches(judging(parameters=True), MadeVehicle(1), baseline=baseline_for())
    bench.run(4.0)
    [(_, answered)] = shown(asked(bench, bench.far, setting(name, value)))
    assert answered == pytest.approx(in_force)
    assert any(words in line for line in bench.host.lines)


def test_learning_anew_is_begun_and_given_up_by_a_parameter(benches: Benches) -> None:
    fitter = FakeFitter(LearningFailed("not now"))
    bench = benches(judging(parameters=True), MadeVehicle(1), baseline=baseline_for(), fitter=fitter)
    bench.run(4.0)
    assert shown(asked(bench, bench.far, setting("MD_LEARN_S", 60.0))) == [("MD_LEARN_S", 60.0)]
    bench.run(4.0)
    session = bench.daemon.fleet.vehicles[1].session
    assert session.state is State.LEARNING
    # While there is nothing to judge by, the thresholds cannot be set.
    assert shown(asked(bench, bench.far, setting("MD_THR_SCALE", 2.0))) == [("MD_THR_SCALE", 1.0)]
    assert shown(asked(bench, bench.far, setting("MD_LEARN_S", 0.0))) == [("MD_LEARN_S", 0.0)]
    bench.run(4.0)
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING


def test_rates_that_are_needed_are_kept_and_everything_else_passes(benches: Benches) -> None:
    bench = benches(judging(keep_rates=True), MadeVehicle(1), baseline=baseline_for(), links_behind=1)
    bench.run(4.0)
    received(bench.far)
    ours = STATION.encode(MessageId.COMMAND_LONG, 1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, MessageId.RAW_IMU, 1_000_000)
    other = STATION.encode(
        MessageId.COMMAND_LONG, 1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, MessageId.SYS_STATUS, 1_000_000
    )
    [ack] = of(asked(bench, bench.behind[0], ours), MessageId.COMMAND_ACK)
    assert (field(ack, "result"), field(ack, "target_system")) == (MavResult.DENIED, 255)
    asked(bench, bench.behind[0], other)
    asked(bench, bench.behind[0], STATION.encode(MessageId.REQUEST_DATA_STREAM, 1, 1, 0, 4, 1))
    frames = received(bench.far)
    assert [field(one, "param1") for one in of(frames, MessageId.COMMAND_LONG)] == [MessageId.SYS_STATUS]
    groups = of(frames, MessageId.REQUEST_DATA_STREAM)
    assert {field(one, "req_stream_id") for one in groups} == {2, 6, 11}
    assert {one.compid for one in groups} == {Component.ONBOARD_COMPUTER}


def test_vehicles_beyond_the_bound_are_not_watched_and_that_is_said_once(benches: Benches) -> None:
    bench = benches(Settings(connect=UDP_IN, learn=50.0, max_vehicles=2), *(MadeVehicle(k) for k in (1, 2, 3)))
    bench.run(6.0)
    assert set(bench.daemon.fleet.vehicles) == {1, 2}
    words = [line for line in bench.host.lines if "vehicle 3" in line]
    assert words == ["vehicle 3: not watched: there are 2 vehicles already (max_vehicles)"]


def test_a_boat_is_not_watched_and_that_is_said_once(benches: Benches) -> None:
    bench = benches(judging(), MadeVehicle(1), MadeVehicle(2, kind=11), baseline=baseline_for())
    bench.run(8.0)
    assert set(bench.daemon.fleet.vehicles) == {1}
    words = [line for line in bench.host.lines if "vehicle 2" in line]
    assert words == ["vehicle 2: not watched: a boat (MAV_TYPE 11): mavdiag judges multirotors only"]


def test_each_vehicle_of_a_fleet_is_judged_by_its_own_baseline(benches: Benches) -> None:
    own = {2: baseline_for(names=("rotor_trim",)), 3: baseline_for()}
    table = {sysid: VehicleSettings(baseline=Path("b.json")) for sysid in own}
    bench = benches(Settings(connect=UDP_IN, vehicles=table), *(MadeVehicle(k) for k in (1, 2, 3)), baselines=own)
    bench.run(4.0)
    found = {sysid: vehicle.session.baseline for sysid, vehicle in bench.daemon.fleet.vehicles.items()}
    assert found == own
    words = [line for line in bench.host.lines if "vehicle 1" in line]
    assert words == ["vehicle 1: not watched: it has no baseline; name one in [vehicles.1]"]
    assert not any("but several fly" in line for line in bench.host.lines)
    assert "watching 2 vehicles by a baseline of its own" in bench.host.lines[0]
