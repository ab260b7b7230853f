"""The emulator and the daemon on one virtual clock: rates that others reset, and ESC telemetry."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import pytest
from made_vehicle import Bench
from virtual_flight import GroundStation, VirtualFlight, healthy_flights, learnt

from detector.config import Settings
from detector.states import State
from mavdiag.baseline import Baseline
from mavdiag.link.codec import Decoder, Frame, field_index
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.link.ports import Chunk
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

VEHICLE = replace(qdrone2(), propulsion=replace(qdrone2().propulsion, load_share=0.2))
SETTLED_S = 15.0  # the live gate's 5 s, and the longest window
FLOWN_S = 46.0
SENT = {
    MessageId.HEARTBEAT,
    MessageId.STATUSTEXT,
    MessageId.NAMED_VALUE_FLOAT,
    MessageId.COMMAND_LONG,
    MessageId.PARAM_REQUEST_READ,
    MessageId.TIMESYNC,
}
NAME = field_index(MessageId.PARAM_REQUEST_READ, "param_id")
COMMAND = field_index(MessageId.COMMAND_LONG, "command")
STREAMS = (MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET, MessageId.SERVO_OUTPUT_RAW, MessageId.ATTITUDE)


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    return learnt(healthy_flights(range(3), 40.0, vehicle=VEHICLE))


@pytest.mark.parametrize(
    "station", [GroundStation.by_streams(), GroundStation.by_intervals(STREAMS)], ids=["66", "511"]
)
def test_l3_a_ground_station_that_resets_rates_every_10_s_costs_a_tenth_of_the_time_at_most(
    baseline: Baseline, station: GroundStation
) -> None:
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json")), baseline=baseline)
    try:
        flight = VirtualFlight(bench, station)
        flight.fly(PlantConfig(seed=9, vehicle=VEHICLE), FLOWN_S)
        session = bench.daemon.fleet.vehicles[1].session
        requests = [line for line in bench.host.lines if "asked for RAW_IMU" in line]
    finally:
        bench.close()
    assert session.working
    assert not any(State.FAULTED in line for line in bench.host.lines)
    assert flight.share_judged(SETTLED_S) >= 0.9
    assert len(station.times) == 4
    assert len(requests) == len(station.times)  # one each: it is answered, and nobody fights
    assert any("does a ground station set it? (MAVProxy: set streamrate -1)" in line for line in bench.host.lines)


def test_what_tells_rotors_and_filter_is_read_while_it_learns_and_nothing_is_ever_set() -> None:
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", learn=500.0), links_behind=0)
    heard: list[Frame] = []
    decoder, receive = Decoder(), bench.far.receive

    def listening(timeout_s: float) -> list[Chunk]:
        chunks = receive(timeout_s)
        heard.extend(frame for data, host_ns in chunks for frame in decoder.feed_datagram(data, host_ns))
        return chunks

    try:
        with patch.object(bench.far, "receive", listening):
            VirtualFlight(bench).fly(PlantConfig(seed=3), 8.0)
        parameters = bench.daemon.fleet.link.vehicles[1].parameters
    finally:
        bench.close()
    assert (parameters["FRAME_CLASS"], parameters["INS_GYRO_FILTER"]) == (1.0, 20.0)
    assert {frame.msgid for frame in heard} <= SENT
    names = Counter(frame.fields[NAME] for frame in heard if frame.msgid == MessageId.PARAM_REQUEST_READ)
    assert max(names.values()) <= 3  # an output that this vehicle does not have
    commands = {frame.fields[COMMAND] for frame in heard if frame.msgid == MessageId.COMMAND_LONG}
    assert commands <= {MavCmd.SET_MESSAGE_INTERVAL}


@pytest.mark.parametrize("profile", ["ardupilot", "px4"])
def test_esc_telemetry_is_learnt_from_metered_and_the_weak_rotor_is_named(profile: str) -> None:
    baseline = learnt(healthy_flights(range(3), 40.0, profile, vehicle=VEHICLE))
    assert "rotor_speed" in {entry.spec.kind for entry in baseline.monitors}
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json")), baseline=baseline)
    damage = Injection(RotorDamage(thrust_factor=0.9, drag_factor=0.9), rotor=3, onset_s=20.0)
    try:
        VirtualFlight(bench).fly(PlantConfig(seed=9, vehicle=VEHICLE, injections=(damage,)), 35.0, profile)
        (figures,) = bench.daemon.fleet.figures()
        lines = bench.host.lines
    finally:
        bench.close()
    assert any("PROP FAULT motor 3" in line for line in lines)
    assert dict(figures.rates)["rotor_speed"] == pytest.approx(10.0, rel=0.1)
    assert figures.diagnosis.rotor == 3
    ratios = {monitor: ratio for monitor, _, ratio in figures.ratios}
    assert ratios["rotor_speed"] > 1.0
    assert "rotor_trim" in ratios
