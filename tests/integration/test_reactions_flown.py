"""The short form of benchmarks/reactions.py: a damaged vehicle is flown home by the detector, or is let alone."""

from dataclasses import replace
from typing import cast

import numpy as np
from loop_plant import HIL_HZ, LoopPlant
from made_vehicle import Bench
from reactions import IN_LOOP, PROFILE, Station, fly
from virtual_flight import VirtualFlight

from detector.config import Settings
from mavdiag.link.messages import MavCmd, MessageId
from sitl_plant.plant import Plant, PlantSamples


def test_a_mission_with_a_crack_is_flown_home_after_the_delay_and_a_call_off_lets_it_go_on() -> None:
    flown = fly("mission", 100, "F2/SV3")
    assert flown.commands == ["rtl"]
    assert flown.announced
    assert flown.late_s is not None
    assert -0.01 <= flown.late_s <= 0.5
    assert flown.down
    left = fly("mission", 101, "F2/SV3", call="stick", until_s=50.0)
    assert left.called_off
    assert left.commands == []
    assert not left.down


def test_a_healthy_mission_is_left_alone() -> None:
    flown = fly("mission", 102, until_s=40.0)
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
