"""What every monitor keeps to. A new monitor needs no line here: the flights have every signal, and it is fitted."""

import dataclasses
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flying_telemetry import DT_NS, DT_S, flying, flying_front, flying_rows, without
from hypothesis import given, settings
from hypothesis import strategies as st
from made_monitor import MadeUp
from made_telemetry import START_NS, cut
from scipy.optimize import minimize

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors import MONITORS, by_name, monitor_of
from mavdiag.monitors.base import LearnContext, Monitor
from mavdiag.monitors.fitting import variance_law
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, Signal, Telemetry

SAMPLES = 3200
STOP_S = 20.0
LONGEST_LIMIT_S = 2.0  # of all signals: how long a last value holds (`rows.align.HELD`)
CONTEXT = LearnContext(Airframe(layout=layout_named("x")), None, DT_S, 11)
ARRAYS = ("t_ns", "value", "valid", "level", "signal", "rotors")


ALL: tuple[type[Monitor[Any]], ...] = (*MONITORS, MadeUp)
every_monitor = pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)


@cache
def healthy() -> list[list[Rows]]:
    return [flying_rows(flying(SAMPLES, 100))]


@cache
def specs(kind: type[Monitor[Any]]) -> tuple[Any, ...]:
    return kind.fit(healthy(), CONTEXT)


def built(kind: type[Monitor[Any]]) -> Monitor[Any]:
    return kind(specs(kind)[0])


def rough_flight(seed: int) -> Telemetry:
    """Two stretches of flight with a break of 1.5 s between them, a gap of 80 ms, and one of 0.5 s in the set-point."""
    rough = without(flying(SAMPLES, seed), (10.0, 10.08), (18.0, 19.5))
    return without(rough, (4.0, 4.5), signals=(Signal.ATTITUDE_SETPOINT,))


@every_monitor
def test_new_propellers_and_a_further_session_give_a_fit_that_still_judges(kind: type[Monitor[Any]]) -> None:
    other = [flying_rows(flying(SAMPLES, 101))]
    spec, factor = built(kind).renewed(other, CONTEXT)
    assert 0.0 < factor < math.inf
    longer, more = built(kind).extended(other, 2)
    assert 0.0 <= more < math.inf
    for one in (spec, longer):
        assert type(one) is kind.spec_type
        assert run(kind(one), other[0]).valid.any()


def run(monitor: Monitor[Any], rows: list[Rows]) -> Statistic:
    parts = [one for one in monitor.over(rows) if len(one)]
    joined = {name: np.concatenate([getattr(one, name) for one in parts]) for name in ARRAYS}
    return Statistic(period_s=parts[0].period_s, **joined)


@every_monitor
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 3), edges=st.lists(st.integers(0, SAMPLES), max_size=60))
def test_any_chunking_gives_the_same_values(kind: type[Monitor[Any]], seed: int, edges: list[int]) -> None:
    telemetry = rough_flight(seed)
    expected, front = run(built(kind), flying_rows(telemetry)), flying_front()
    state, rows = front.start(), list[Any]()
    for chunk in cut(telemetry, sorted(START_NS + edge * DT_NS for edge in edges)):
        rows += front.step(state, chunk)
    found = run(built(kind), [one for one in (*rows, *front.finish(state)) if isinstance(one, Rows)])
    for name in ("t_ns", "valid"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("value", "level", "signal", "rotors"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-12, err_msg=name)


@every_monitor
def test_inputs_are_left_alone(kind: type[Monitor[Any]]) -> None:
    rows = flying_rows(rough_flight(1))
    parts: list[Any] = [part for one in rows for part in (one.block, one.rates)]
    for part in parts:
        for field in dataclasses.fields(part):
            value = getattr(part, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
    run(built(kind), rows)  # a write would raise


@every_monitor
def test_what_must_not_be_judged_is_not(kind: type[Monitor[Any]]) -> None:
    rows = flying_rows(rough_flight(3))
    may = {int(t) for one in rows for t in one.block.t_ns[one.block.valid]}
    found = run(built(kind), rows)
    judged = {int(t) for t in found.t_ns[found.valid]}
    assert judged
    assert judged <= may


@every_monitor
def test_b2_a_need_that_stops_is_not_judged(kind: type[Monitor[Any]]) -> None:
    """B2: inputs that stopped were frozen and judged for ever."""
    monitor = built(kind)
    for signal in sorted(monitor.signals):
        found = run(monitor, flying_rows(without(flying(SAMPLES, 4), (STOP_S, 1e9), signals=(signal,))))
        t_s = (found.t_ns - START_NS) / 1e9
        assert found.valid[t_s < STOP_S].any(), signal
        assert not found.valid[t_s > STOP_S + LONGEST_LIMIT_S + 0.1].any(), signal


@every_monitor
def test_what_it_does_not_need_may_be_absent(kind: type[Monitor[Any]]) -> None:
    monitor = built(kind)
    main = {Signal.BODY_RATE, *monitor.signals}
    others = [signal for signal in Signal if signal not in main]
    assert run(monitor, flying_rows(without(flying(SAMPLES, 5), (0.0, 1e9), signals=others))).valid.any()


@every_monitor
def test_a_number_that_is_none_is_not_judged(kind: type[Monitor[Any]]) -> None:
    columns = {
        Signal.BODY_RATE: "rate",
        Signal.SPECIFIC_FORCE: "force",
        Signal.VIBRATION: "vibration",
        Signal.ACTUATOR: "actuator",
        Signal.ROTOR_SPEED: "rotor_speed",
        Signal.TORQUE_COMMAND: "torque",
        Signal.THRUST_SETPOINT: "thrust",
    }
    monitor = built(kind)
    for signal in sorted(monitor.signals & columns.keys()):
        (rows,) = (one for one in flying_rows(flying(SAMPLES, 6)) if len(one.block) > 100)
        getattr(rows.block, columns[signal])[2000:2060] = np.nan
        rates = flying_front().rates
        rows = rates.step(rates.start(), rows.block)
        found, bad_ns = run(monitor, [rows]), rows.block.t_ns[[2000, 2059]]
        spoilt = (found.t_ns >= bad_ns[0]) & (found.t_ns <= bad_ns[1])
        assert spoilt.any(), signal
        assert not found.valid[spoilt].any(), signal
        assert np.isfinite(found.value[found.valid]).all(), signal


@every_monitor
def test_flights_without_any_signal_are_refused(kind: type[Monitor[Any]]) -> None:
    gyro = Telemetry(tuple(one for one in flying(50, 7).series if one.signal is Signal.BODY_RATE))
    with pytest.raises((InputError, IdentificationError)) as error:
        kind.fit([flying_rows(gyro)], CONTEXT)
    assert "\n" not in str(error.value)


@every_monitor
def test_its_class_says_what_the_project_must_know(kind: type[Monitor[Any]]) -> None:
    assert 0 < len(kind.label) <= 10
    assert kind.needs
    assert kind.clear_s >= 0
    monitor = built(kind)
    assert monitor.unit
    assert monitor.signals <= kind.needs
    assert monitor.delay_s >= 0
    assert bool(kind.evidence) == bool(run(monitor, healthy()[0]).rotors.size)
    for word in ("Warm-up", "Latency", "False alarms", "Blind spots"):
        assert word in (kind.__doc__ or ""), f"{kind.name} does not state: {word}"


def test_names_are_unique_and_find_their_monitor() -> None:
    names = [kind.name for kind in ALL]
    assert len({*names}) == len({kind.label for kind in ALL}) == len({kind.spec_type for kind in ALL}) == len(ALL)
    for kind in MONITORS:
        assert by_name(kind.name) is kind
        assert type(monitor_of(specs(kind)[0])) is kind


@given(st.integers(0, 999), st.floats(-2.0, 2.0))
def test_the_variance_law_is_the_likeliest(seed: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    busy = rng.exponential(1.0, 500)
    squares = np.maximum(1.0 + slope * busy, 0.05) * rng.standard_normal(500) ** 2

    def cost(k: FloatArray) -> float:  # of minus the logarithm of the likelihood
        variance = k[0] + k[1] * busy
        return float(np.mean(np.log(variance) + squares / variance))

    mean = float(squares.mean())
    best = minimize(cost, (mean, 0.1), bounds=((0.05 * mean, None), (0.0, None)))
    assert cost(np.array(variance_law(squares, busy))) < best.fun + 0.01


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("fsd", "margin_rad_s", 0.0),
        ("innovation", "k0", (1.0, 0.0, 1.0)),
        ("rotor_signature", "window_s", 0.0),
        ("vibration_level", "healthy", math.nan),
        ("rotor_trim", "mean", (math.inf, 0.0, 0.0)),
        ("sensor_noise", "rms", (1.0,) * 5),
        ("sensor_drift", "tilt", 0.0),
        ("thrust_loss", "per_command", math.inf),
    ],
)
def test_a_spec_that_describes_nothing_is_refused_by_its_field(kind: str, field: str, value: object) -> None:
    with pytest.raises(InputError, match=f"{kind}: {field}"):
        replace(specs(by_name(kind))[0], **{field: value})


def test_what_fits_together_is_checked_together() -> None:
    with pytest.raises(InputError, match="not known"):
        replace(specs(RotorTrim)[0], source="torque")
    with pytest.raises(InputError, match="odd"):
        replace(specs(RotorSignature)[0].motion, window=4)
