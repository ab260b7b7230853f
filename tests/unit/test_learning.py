"""Learning from healthy flights: what it needs, and what it says when it does not get it."""

import dataclasses

import numpy as np
import pytest
from made_telemetry import cut, flight

from mavdiag.errors import IdentificationError, InputError
from mavdiag.judging import LogVerdict, Verdict, between, exit_code, judge
from mavdiag.learning import Flight, learn, thesis_options
from mavdiag.logs import Log
from mavdiag.telemetry import Series, Signal, Telemetry

ROLL = thesis_options()
NOW = "2026-01-01T00:00:00+00:00"


def made(seed: int, telemetry: Telemetry | None = None, profile: str = "qdrone2") -> Flight:
    return Flight(f"f{seed}", f"{seed:064x}", profile, telemetry or flight(8000, seed))


def without(telemetry: Telemetry, signal: Signal) -> Telemetry:
    return Telemetry(tuple(one for one in telemetry.series if one.signal is not signal))


def turned(telemetry: Telemetry) -> Telemetry:
    """The same flight with the gyro's sign reversed."""
    return Telemetry(
        tuple(
            dataclasses.replace(one, values=-one.values) if one.signal is Signal.BODY_RATE else one
            for one in telemetry.series
        )
    )


def test_no_flight_is_refused() -> None:
    with pytest.raises(InputError, match="no healthy flight"):
        learn([], ROLL, created=NOW)


@pytest.mark.parametrize("signal", [Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT])
def test_a_missing_signal_is_named_with_the_flight(signal: Signal) -> None:
    with pytest.raises(InputError, match=f"f7: no {signal.replace('_', ' ')}"):
        learn([made(7, without(flight(8000, 7), signal))], ROLL, created=NOW)


def test_a_flight_on_the_ground_is_refused() -> None:
    grounded = Telemetry(
        tuple(
            Series(one.signal, one.t_ns, one.host_ns, 0 * one.values) if one.signal is Signal.ARMED else one
            for one in flight(8000, 3).series
        )
    )
    with pytest.raises(InputError, match=r"f3: only 0\.0 s of airborne flight"):
        learn([made(3, grounded)], ROLL, created=NOW)


def test_flights_of_different_links_are_not_mixed() -> None:
    with pytest.raises(InputError, match="different links"):
        learn([made(1), made(2, profile="px4")], ROLL, created=NOW)


def test_flights_of_different_rates_are_not_mixed() -> None:
    slow = Telemetry(
        tuple(Series(s.signal, s.t_ns[::2], s.host_ns[::2], s.values[::2]) for s in flight(8000, 2).series)
    )
    with pytest.raises(InputError, match=r"different gyro rates \(500\.0 to 1000\.0 Hz\)"):
        learn([made(1), made(2, slow)], ROLL, created=NOW)


def test_a_reversed_gyro_is_noticed() -> None:
    with pytest.raises(IdentificationError, match="roll: the gyro turns against its set-point"):
        learn([made(1, turned(flight(8000, 1)))], ROLL, created=NOW)


def test_a_still_vehicle_cannot_be_learnt_from() -> None:
    still = Telemetry(
        tuple(
            Series(s.signal, s.t_ns, s.host_ns, 0 * s.values) if s.signal is Signal.ATTITUDE_SETPOINT else s
            for s in flight(8000, 1).series
        )
    )
    with pytest.raises(IdentificationError, match="roll: u is constant"):
        learn([made(1, still)], ROLL, created=NOW)


def logged(seed: int, telemetry: Telemetry, profile: str = "qdrone2") -> Log:
    return Log(f"log{seed}", f"{seed:064x}", profile, telemetry, 0)


def test_a_push_is_a_fault_at_its_time_and_a_healthy_flight_is_not() -> None:
    baseline = learn([made(i) for i in range(1, 9)], ROLL, created=NOW)
    push = np.zeros(10_000)
    push[5000:5600] = 0.3
    verdict = judge(logged(50, flight(10_000, 50, push=push)), baseline)
    assert verdict.verdict is Verdict.FAULT
    first = verdict.events[0]
    assert 6.0 < first.t_s < 6.3
    assert first.event.statistic == pytest.approx(0.6, abs=0.12)
    assert verdict.monitors[0].maximum == first.event.statistic
    healthy = [judge(logged(seed, flight(8000, seed)), baseline).verdict for seed in range(60, 80)]
    # The rule's own price is one alarm in nine flights; 8 of 20 would have probability 1e-4.
    assert healthy.count(Verdict.FAULT) < 8


@pytest.mark.parametrize(
    ("telemetry", "profile", "reason"),
    [
        (without(flight(8000, 1), Signal.BODY_RATE), "qdrone2", "no body rate"),
        (without(flight(8000, 1), Signal.ATTITUDE_SETPOINT), "qdrone2", "no attitude setpoint"),
        (flight(8000, 1), "px4", "another link: link.profile"),
        (flight(900, 1), "qdrone2", "never airborne"),
    ],
)
def test_what_cannot_be_judged_says_why(telemetry: Telemetry, profile: str, reason: str) -> None:
    baseline = learn([made(1), made(2)], ROLL, created=NOW)
    verdict = judge(logged(1, telemetry, profile), baseline)
    assert verdict.verdict is Verdict.NOT_JUDGEABLE
    assert verdict.reason.startswith(reason)


def test_a_part_of_a_log_is_cut_by_the_vehicle_s_clock() -> None:
    part = between(flight(8000, 1), 3.0, 4.0)
    t = part.need(Signal.BODY_RATE).t_ns
    assert (t[0] / 1e9, len(t)) == (3.0, 1000)
    with pytest.raises(InputError, match=r"no data between 5.0 s and 6.0 s .* from 1\.0 to 1\.8 s"):
        between(flight(800, 1), 5.0, 6.0)
    assert len(cut(part, [])) == 1


def test_the_exit_code_is_that_of_the_gravest_verdict() -> None:
    healthy, fault, unknown, error = Verdict.HEALTHY, Verdict.FAULT, Verdict.NOT_JUDGEABLE, Verdict.ERROR
    assert exit_code([healthy]) == 0
    assert exit_code([healthy, unknown]) == 3
    assert exit_code([unknown, fault]) == 1
    assert exit_code([fault, error, unknown]) == 2
    assert LogVerdict("x", error, "y").events == ()
