"""Vehicles with six rotors and more, take-offs and turning noses, as a receiver reads them from the wire."""

from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mavdiag.link.codec import Decoder, Frame, field_index
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.telemetry import Signal, Telemetry
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.emulator import recorded
from sitl_plant.options import FlightPlan
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import Vehicle, load_vehicle, vehicle_from

SECONDS = 1.0
MADE_UP = """
base = "qdrone2"
name = "made up"
[body]
mass_kg = 2.0
"""


@cache
def made_up(folder: Path) -> Vehicle:
    """A hexarotor of a file: six rotors on a ring."""
    rotors = [
        f'[[rotors]]\nname = "{i}"\nposition_m = [{0.2 * np.cos(turn)}, {0.2 * np.sin(turn)}, 0.0]\nspin = "{spin}"\n'
        for i, (turn, spin) in enumerate(zip(np.arange(6) * np.pi / 3, ("cw", "ccw") * 3, strict=True))
    ]
    path = folder / "made_up.toml"
    path.write_text(MADE_UP + "".join(rotors))
    return load_vehicle(path)


def frames_of(config: PlantConfig, profile: str, rate_hz: float, seconds: float = SECONDS) -> list[Frame]:
    decoder, plan = Decoder(), FlightPlan(config, dialect_named(profile), rate_hz)
    return [frame for t_ns, data in recorded(plan, seconds, lambda _: None) for frame in decoder.feed(data, t_ns)]


def telemetry_of(frames: list[Frame], profile: str) -> Telemetry:
    return SampleDecoder(PROFILES[profile]).step(SampleState(), frames)[1]


@pytest.mark.parametrize(("profile", "rate_hz"), [("qdrone2", 200.0), ("ardupilot", 50.0), ("px4", 100.0)])
@pytest.mark.parametrize("name", ["hexa-x", "hexa-plus", "octo-x", "made up"])
def test_all_rotors_reach_the_receiver(name: str, profile: str, rate_hz: float, tmp_path: Path) -> None:
    vehicle = made_up(tmp_path) if name == "made up" else vehicle_from(name)
    n, config = len(vehicle.rotors), PlantConfig(vehicle=vehicle, seed=3)
    samples, frames = Plant(config).advance(1000), frames_of(config, profile, rate_hz)
    heard = telemetry_of(frames, profile)
    for signal, truth, tolerance in (
        (Signal.ACTUATOR, samples.duty, 0.6e-3),
        (Signal.ROTOR_SPEED, samples.rotor_speed, 0.06),
    ):
        series = heard.need(signal)
        last = series.host_ns[-1]
        np.testing.assert_allclose(series.values[-1, :n], truth[last // 1_000_000], atol=tolerance, err_msg=signal)
        assert not np.nan_to_num(series.values[:, n:]).any()
    beats = [frame for frame in frames if frame.msgid == MessageId.HEARTBEAT]
    assert beats[0].fields[field_index(MessageId.HEARTBEAT, "type")] == {6: 13, 8: 14}[n]
    count = Counter(frame.msgid for frame in frames)
    if profile == "ardupilot":
        assert count[11030] == count[11031] == 50
    else:
        places = [frame.fields[field_index(MessageId.ESC_STATUS, "index")] for frame in frames if frame.msgid == 291]
        assert places == [0, 4] * 50
