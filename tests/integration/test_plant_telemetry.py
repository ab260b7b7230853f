"""Telemetry without the wire is what the library's own receiver makes of the bytes."""

from functools import cache

import numpy as np
import pytest
from made_telemetry import ROUNDING

from mavdiag.link.codec import Decoder
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import SampleDecoder, SampleState, joined
from mavdiag.telemetry import Signal, Telemetry
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.telemetry import LinkSpec, TelemetryStream, flight_telemetry, telemetry_digest
from sitl_plant.emulator import recorded
from sitl_plant.options import FlightPlan
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

SECONDS = 3.0
CONFIG = PlantConfig(fault="F1/SV3", rotor=2, seed=5, heading_rad=0.7)
LINKS = [
    ("qdrone2", None),
    ("qdrone2", 250.0),
    ("spec", 1000.0),
    ("ardupilot", 100.0),
    ("ardupilot", 50.0),
    ("px4", 160.0),
]


@cache
def flown() -> PlantSamples:
    return Plant(CONFIG).advance(round(SECONDS * 1000))


def over_the_wire(profile: str, rate_hz: float) -> Telemetry:
    decoder, plan = Decoder(), FlightPlan(CONFIG, dialect_named(profile), rate_hz)
    frames = [frame for t_ns, data in recorded(plan, SECONDS, lambda _: None) for frame in decoder.feed(data, t_ns)]
    return SampleDecoder(PROFILES[profile]).step(SampleState(), frames)[1]


@pytest.mark.parametrize(("profile", "rate_hz"), LINKS)
def test_times_and_values_are_those_of_the_wire(profile: str, rate_hz: float | None) -> None:
    direct, _ = flight_telemetry(CONFIG, SECONDS, LinkSpec(profile, rate_hz))
    wire = over_the_wire(profile, rate_hz or PROFILES[profile].rate_hz)
    compared = {series.signal for series in direct.series} - {Signal.ARMED}
    assert {
        Signal.ATTITUDE_SETPOINT,
        Signal.BODY_RATE,
        Signal.SPECIFIC_FORCE,
        Signal.ACTUATOR,
        Signal.HEIGHT,
    } <= compared
    assert (Signal.VIBRATION in compared) == PROFILES[profile].vibration
    for signal in compared:
        ours, theirs = direct.need(signal), wire.need(signal)
        untimed = signal is Signal.VOLTAGE or (signal is Signal.ROTOR_SPEED and profile == "ardupilot")
        if not untimed:
            np.testing.assert_array_equal(ours.t_ns, theirs.t_ns, err_msg=signal)
        np.testing.assert_allclose(ours.values[-len(theirs) :], theirs.values, rtol=0.0, atol=ROUNDING, err_msg=signal)
        assert len(ours) - len(theirs) in ((0, 1) if untimed else (0,))


@pytest.mark.parametrize("link", [LinkSpec(), LinkSpec("ardupilot", 100.0, loss=0.2)])
def test_how_a_flight_is_cut_changes_nothing(link: LinkSpec) -> None:
    stream, first, pieces = TelemetryStream(link, CONFIG.seed), 0, []
    for n in (1, 7, 992, 20, 1980):
        pieces.append(stream.step(flown().rows(first, first + n)))
        first += n
    assert telemetry_digest(joined(pieces)) == telemetry_digest(TelemetryStream(link, CONFIG.seed).step(flown()))


def test_loss_takes_its_share_and_repeats_with_the_seed() -> None:
    whole, _ = flight_telemetry(CONFIG, SECONDS)
    holed, _ = flight_telemetry(CONFIG, SECONDS, LinkSpec(loss=0.2))
    again, _ = flight_telemetry(CONFIG, SECONDS, LinkSpec(loss=0.2))
    n = len(whole.need(Signal.BODY_RATE))
    assert abs(len(holed.need(Signal.BODY_RATE)) - 0.8 * n) < 4 * np.sqrt(0.16 * n)
    assert set(holed.need(Signal.BODY_RATE).t_ns) < set(whole.need(Signal.BODY_RATE).t_ns)
    assert telemetry_digest(holed) == telemetry_digest(again)
    assert telemetry_digest(holed) != telemetry_digest(whole)
