"""Sessions of healthy flights: who belongs together, folds that leave whole sessions out, and what a session allows."""

import itertools
from functools import cache

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import FRAME, NOW

from mavdiag.baseline import SESSION_GAP_NS, Baseline, dump, parse
from mavdiag.chain import chain_of
from mavdiag.learning import LearnOptions, learn
from mavdiag.learning.flights import sessions_of
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.telemetry import Log, Telemetry
from mavdiag.testing import example_rows
from mavdiag.thresholds.guard import Guard
from mavdiag.thresholds.heldout import Flights, Scores, folds
from mavdiag.thresholds.rule import Threshold, threshold_of
from mavdiag.units import NS_PER_S

MONDAY = 1_777_600_000 * NS_PER_S
HOUR = 3600 * NS_PER_S


def logs(*started_ns: int) -> list[Log]:
    return [Log(f"f{i}", "", "px4", Telemetry(), started_ns=t) for i, t in enumerate(started_ns)]


@pytest.mark.parametrize(
    ("started", "sessions"),
    [
        ([], []),
        ([MONDAY], [0]),
        ([MONDAY, MONDAY + HOUR // 6, MONDAY + HOUR // 3], [0, 0, 0]),
        ([MONDAY, MONDAY + HOUR], [0, 0]),
        ([MONDAY, MONDAY + HOUR + 1], [0, 1]),
        ([MONDAY, MONDAY + HOUR, MONDAY + 2 * HOUR], [0, 0, 0]),  # each an hour after the one before
        ([MONDAY + 24 * HOUR, MONDAY, MONDAY + 25 * HOUR], [1, 0, 1]),  # numbered by time, whatever the order
        ([0, 0, 0], [0, 1, 2]),  # unknown: each for itself
        ([MONDAY, 0, MONDAY + 60], [1, 0, 1]),
    ],
)
def test_the_wall_clock_tells_the_sessions(started: list[int], sessions: list[int]) -> None:
    assert sessions_of(logs(*started)) == sessions
    assert sessions_of(logs(*[MONDAY] * 5), 2) == [0, 0, 0, 1, 1]  # what is told counts more


def numbered(count: int) -> Flights:
    return [[example_rows(500, segment=i)] for i in range(count)]


def parts(flights: Flights) -> list[int]:
    return [flight[0].block.segment for flight in flights]


def test_with_many_sessions_the_folds_are_ten_and_still_leave_whole_ones_out() -> None:
    sessions = [i // 2 for i in range(30)]
    found = [(parts(out), parts(rest)) for out, rest in folds(numbered(30), sessions=sessions)]
    assert len(found) == 10
    assert sorted(itertools.chain.from_iterable(out for out, _ in found)) == list(range(30))
    for out, rest in found:
        assert not {sessions[i] for i in out} & {sessions[i] for i in rest}
        assert sorted(out + rest) == list(range(30))


def of(sessions: int, guard: Guard = RotorTrim.guard) -> Threshold:
    scores = Scores(np.array([0.03, 0.031, 0.029, 0.03]), np.full(4, 10.0))
    return threshold_of(scores, flights=4, sessions=sessions, budget_per_hour=0.36, guard=guard)


def test_the_allowance_for_other_sessions_fades_with_them() -> None:
    allowed = [of(n).session_allowance for n in (1, 2, 3, 4, 5, 20)]
    assert allowed == pytest.approx([0.06, 0.045, 0.03, 0.015, 0.0, 0.0])
    values = [of(n).value for n in (1, 5)]
    assert values[0] - values[1] == pytest.approx(0.06)
    assert of(1).value - of(1).session_allowance == pytest.approx(of(5).value)


def flown(seed: int, started_ns: int) -> Log:
    return Log(f"f{seed}", f"{seed:064x}", "px4", flying(2500, seed), started_ns=started_ns)


@cache
def two_days() -> Baseline:
    flights = [flown(i, MONDAY + (i // 2) * 24 * HOUR + (i % 2) * HOUR // 6) for i in range(4)]
    return learn(flights, LearnOptions(airframe=FRAME, monitors=("rotor_trim", "trim_step")), created=NOW)


def test_a_baseline_knows_the_sessions_of_its_flights() -> None:
    made = two_days()
    assert [one.session for one in made.provenance.logs] == [0, 0, 1, 1]
    assert {entry.threshold.sessions for entry in made.monitors} == {2}
    assert "from 4 flights in 2 sessions" in str(made)
    assert "in a session of these flights; another may differ" in str(made)
    assert parse(dump(made)) == made


@pytest.mark.parametrize(
    ("started_ns", "same"),
    [
        (0, False),
        (MONDAY, True),
        (MONDAY - SESSION_GAP_NS, True),
        (MONDAY - SESSION_GAP_NS - 1, False),
        (MONDAY + HOUR // 6 + SESSION_GAP_NS, True),
        (MONDAY + HOUR // 6 + SESSION_GAP_NS + 1, False),
        (MONDAY + 24 * HOUR + 5, True),
        (MONDAY + 48 * HOUR, False),
    ],
)
def test_a_flight_within_an_hour_of_a_healthy_one_is_of_its_session(started_ns: int, same: bool) -> None:
    made = two_days()
    assert made.same_session(started_ns) is same
    limits = {slot.monitor.name: slot.threshold for slot in chain_of(made, started_ns).slots}
    for entry in made.monitors:
        allowed = entry.threshold.session_allowance if same else 0.0
        assert limits[entry.spec.kind] == pytest.approx(entry.threshold.value - allowed)
    assert next(e for e in made.monitors if e.spec.kind == "rotor_trim").threshold.session_allowance > 0.005
