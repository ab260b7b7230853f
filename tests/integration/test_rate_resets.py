"""A ground station that sets rates on the vehicle's link, against the daemon, on a virtual clock with the emulator."""

from pathlib import Path

import pytest
from made_vehicle import Bench
from virtual_flight import GroundStation, VirtualFlight, healthy_flights, learnt

from detector.config import Settings
from detector.states import State
from mavdiag.baseline import Baseline
from mavdiag.link.codec import field_index
from mavdiag.link.messages import MessageId
from sitl_plant.plant import PlantConfig

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
    return learnt(healthy_flights(range(3), 40.0))


@pytest.mark.parametrize(
    "station", [GroundStation.by_streams(), GroundStation.by_intervals(STREAMS)], ids=["66", "511"]
)
def test_l3_a_ground_station_that_resets_rates_every_10_s_costs_a_tenth_of_the_time_at_most(
    baseline: Baseline, station: GroundStation
) -> None:
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json")), baseline=baseline)
    try:
        flight = VirtualFlight(bench, station)
        flight.fly(PlantConfig(seed=9), FLOWN_S)
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
