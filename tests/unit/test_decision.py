"""The verdict's stories, its table, and its independence of how the readings are cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.decision import fusion
from mavdiag.decision.events import Reading
from mavdiag.decision.fusion import NEXT, Change, Channel, Finding, FusionSpec, Height, Stage, start, step
from mavdiag.errors import UsageError
from mavdiag.telemetry import NS_PER_S, FloatArray

SPEC = FusionSpec((Channel("vibration", "g mm", 0.5), Channel("energy", "x healthy rms", 4.0, delay_s=0.05)))
STEP_S = 0.02


def reading(statistic: FloatArray, *, rotor: int | None = 1, first_s: float = 0.0, dt_s: float = STEP_S) -> Reading:
    """A reading every `dt_s`; the evidence points at `rotor`, or nowhere."""
    t_ns = np.round((first_s + dt_s * np.arange(len(statistic))) * NS_PER_S).astype(np.int64)
    rotors = np.full((len(statistic), 4), 0.0)
    if rotor is not None:
        rotors[:, rotor - 1] = 0.9
    return Reading(t_ns, statistic, statistic, statistic, np.isfinite(statistic), rotors)


def nothing() -> Reading:
    return reading(np.empty(0))


def findings(vibration: Reading, energy: Reading) -> list[Finding]:
    return list(step(SPEC, start(SPEC), (vibration, energy))[1])


def profile(*pieces: tuple[float, float]) -> FloatArray:
    """Pieces of (seconds, level)."""
    return np.concatenate([np.full(round(span / STEP_S), level) for span, level in pieces])


def test_a_calm_flight_says_nothing() -> None:
    assert findings(reading(profile((10, 0.3))), reading(profile((10, 2.0)))) == []


def test_one_monitor_above_its_threshold_declares_and_names_the_rotor() -> None:
    found = findings(reading(profile((3, 0.3), (3, 2.1)), rotor=2), reading(profile((6, 1.0)), rotor=None))
    assert [one.change for one in found] == [Change.DECLARED]
    first = found[0]
    assert (first.monitor, first.statistic, first.threshold, first.rotor) == ("vibration", 2.1, 0.5, 2)
    assert first.t_ns == 3 * NS_PER_S
    assert first.reason == "vibration 2.1 g mm > 0.5; rotor 2"


def test_a_reading_counts_from_when_it_is_known() -> None:
    found = findings(nothing(), reading(profile((3, 1.0), (3, 6.0))))
    assert found[0].t_ns == round(3.05 * NS_PER_S)


def test_coming_near_is_suspected_and_goes_away_after_two_calm_seconds() -> None:
    found = findings(reading(profile((2, 0.3), (1, 0.42), (1, 0.3), (1, 0.36), (4, 0.3))), nothing())
    assert [one.change for one in found] == [Change.SUSPECTED, Change.CLEARED]
    assert found[1].t_ns == pytest.approx(7 * NS_PER_S, abs=0.11 * NS_PER_S)


def test_a_fault_stays_declared_through_short_breaks() -> None:
    breaks = profile((2, 0.3), *[(1.5, 1.0), (1.5, 0.2)] * 3, (3, 0.2))
    found = findings(reading(breaks), nothing())
    assert [one.change for one in found] == [Change.DECLARED, Change.CLEARED]
    assert found[1].rotor == 1


def test_a_gap_in_the_readings_does_not_clear_a_fault() -> None:
    gap = profile((2, 0.3), (1, 1.0), (6, np.nan), (1, 0.2))
    assert [one.change for one in findings(reading(gap), nothing())] == [Change.DECLARED]


def test_the_name_may_come_later() -> None:
    crack = reading(profile((2, 1.0), (4, 5.0)), rotor=None)
    crack.rotors[200:, 2] = 0.9
    found = findings(nothing(), crack)
    assert [(one.change, one.rotor) for one in found] == [(Change.DECLARED, None), (Change.LOCATED, 3)]
    assert "rotor ?" in found[0].reason
    assert found[1].t_ns == round(4.05 * NS_PER_S) + 0 or found[1].t_ns <= round(4.15 * NS_PER_S)


def test_a_silent_monitor_loses_its_say() -> None:
    shaking = reading(profile((3, 0.3), (0.5, 0.48)), rotor=2)
    found = findings(shaking, reading(profile((3, 1.0), (7, 1.0)), rotor=None))
    assert [one.change for one in found] == [Change.SUSPECTED, Change.CLEARED]


def test_the_table_names_no_step_back_into_suspicion() -> None:
    assert all(stage is not Stage.SUSPECTED for (came, _), (stage, _) in NEXT.items() if came is Stage.DECLARED)
    assert {change for _, change in NEXT.values()} == {Change.SUSPECTED, Change.DECLARED, Change.CLEARED}
    assert (Stage.QUIET, Height.HELD) not in NEXT


@pytest.mark.parametrize("unit", ["g mm", "x healthy rms", "fraction of hover", "s"])
@pytest.mark.parametrize("monitor", ["vibration", "energy", "innovation", "effort", "shake", "latency"])
def test_a_reason_fits_a_status_text(monitor: str, unit: str) -> None:
    for statistic, threshold in ((123.456, 0.0123), (1e-7, 1e9), (2.14, 0.5)):
        one = Finding(Change.DECLARED, 0, monitor, unit, statistic, threshold, 12, 0.5)
        assert len(one.reason.encode()) <= 50
        assert one.reason.startswith(monitor)


def test_the_readings_must_match_the_channels() -> None:
    with pytest.raises(UsageError):
        step(SPEC, start(SPEC), (nothing(),))
    with pytest.raises(UsageError):
        Channel("energy", "", 0.0)


@given(
    seed=st.integers(0, 20),
    cuts=st.lists(st.integers(0, 1000), max_size=12),
)
def test_any_chunking_gives_the_same_findings(seed: int, cuts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    levels = np.abs(np.cumsum(rng.normal(0, 0.05, (2, 500)), axis=1)) * [[0.5], [4.0]]
    levels[:, rng.random(500) < 0.05] = np.nan
    parts = [reading(levels[0], rotor=int(rng.integers(4)) + 1), reading(levels[1], rotor=None, dt_s=0.01)]
    whole = step(SPEC, start(SPEC), parts)[1]
    state, pieces = start(SPEC), list[Finding]()
    delays = [round(channel.delay_s * NS_PER_S) for channel in SPEC.channels]
    for low, high in zip([-1, *sorted(cuts)], [*sorted(cuts), 10**6], strict=True):
        chunk = []
        for one, delay in zip(parts, delays, strict=True):
            known = (one.t_ns + delay) // (NS_PER_S // 100)
            keep = (known > low) & (known <= high)
            chunk.append(Reading(*(getattr(one, name)[keep] for name in FIELDS)))
        state, more = step(SPEC, state, chunk)
        pieces += more
    assert tuple(pieces) == whole


FIELDS = ("t_ns", "statistic", "level", "signal", "valid", "rotors")


def test_quiet_rows_cost_little() -> None:
    state, rows = start(SPEC), reading(np.full(20_000, 0.3), dt_s=0.001)
    heard, _ = fusion._worth_a_look(SPEC.channels[0], rows, rows.t_ns, state.seen[0])
    assert len(heard) == 200  # ten a second of the thousand
