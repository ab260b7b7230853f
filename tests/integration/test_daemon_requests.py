"""The whole daemon on a virtual clock: what ground stations may ask of it, and several vehicles on one link."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle, received
from memory_port import MemoryEndpoint

from detector.config import Settings, VehicleSettings
from mavdiag.link.codec import Encoder, Frame, field_index
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


def judging(**more: object) -> Settings:
    return Settings.model_validate({"connect": UDP_IN, "baseline": Path("b.json"), **more})


def asked(bench: Bench, end: MemoryEndpoint, frame: bytes) -> list[Frame]:
    """What comes back for a request."""
    received(end)
    end.send(frame)
    bench.run(0.1)
    return received(end)


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
