"""Values are hostile too: glitches, frozen, zero and dead signals, jitter and resolution, through `md.judge`."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from flying_telemetry import DT_NS, flying
from made_baselines import logged, whole
from made_telemetry import cut

import mavdiag as md
from mavdiag.judging import LogVerdict
from mavdiag.rows.align import HI, LO, PLACES, AlignSpec
from mavdiag.rows.quality import LinkQuality, adds_nothing, believed, learnt_quality
from mavdiag.telemetry import FloatArray, IntArray, Log, Series, Signal, Telemetry

N, AT = 3000, 1600
SINCE_NS = AT * DT_NS
Change = Callable[[IntArray, FloatArray], tuple[IntArray, FloatArray] | None]
USED = {
    Signal.BODY_RATE: "innovation",
    Signal.SPECIFIC_FORCE: "sensor_noise",
    Signal.ATTITUDE_SETPOINT: "innovation",
    Signal.ATTITUDE: "sensor_drift",
    Signal.ACTUATOR: "rotor_trim",
    Signal.VIBRATION: "vibration_level",
}


@cache
def calm() -> Log:
    return logged(flying(N, seed=7))


def changed(log: Log, signal: Signal, change: Change) -> Log:
    series = []
    for one in log.telemetry:
        if one.signal is signal:
            t_ns, values = one.t_ns.copy(), one.values.copy()
            t_ns, values = change(t_ns, values) or (t_ns, values)
            one = Series(signal, t_ns, one.host_ns[: len(t_ns)], values)
        series.append(one)
    return replace(log, telemetry=Telemetry(tuple(series)))


def judged(log: Log) -> LogVerdict:
    return md.judge(log, whole())


@cache
def plain() -> LogVerdict:
    return judged(calm())


def judged_s(verdict: LogVerdict, monitor: str) -> float:
    return next(one.judged_s for one in verdict.monitors if one.name == monitor)


def highest(verdict: LogVerdict) -> dict[str, float]:
    return {one.name: (one.maximum or 0.0) / one.threshold for one in verdict.monitors}


@pytest.mark.parametrize("samples", [1, 2, 3])
@pytest.mark.parametrize(
    ("signal", "value"),
    [
        *((Signal.BODY_RATE, one) for one in (0.06, 2.0, 35.0, 1e30)),
        *((Signal.SPECIFIC_FORCE, one) for one in (15.0, 160.0)),
        *((Signal.ACTUATOR, one) for one in (0.0, 1.0)),
        (Signal.ATTITUDE, 3.0),
        (Signal.ATTITUDE_SETPOINT, -2.0),
        (Signal.VIBRATION, 1e4),
    ],
)
def test_a_glitch_is_no_fault_and_no_suspicion(signal: Signal, value: float, samples: int) -> None:
    def strike(t_ns: IntArray, values: FloatArray) -> None:
        at = len(values) // 2
        values[at : at + samples, 0] = value + (values[at, 0] if signal is Signal.BODY_RATE else 0.0)

    found = judged(changed(calm(), signal, strike))
    assert [str(one.stage) for one in found.changes] == [str(one.stage) for one in plain().changes]
    for name, share in highest(found).items():
        assert share < max(highest(plain())[name] + 0.35, 0.8), name


@pytest.mark.parametrize("shift_s", [-3600.0, -0.5, -0.03, 0.03, 0.5, 3600.0])
def test_a_wrong_stamp_ends_no_flight(shift_s: float) -> None:
    def misdate(t_ns: IntArray, values: FloatArray) -> None:
        t_ns[AT] += round(shift_s * 1e9)

    found = judged(changed(calm(), Signal.BODY_RATE, misdate))
    assert found.verdict == plain().verdict
    assert judged_s(found, "innovation") > 0.9 * judged_s(plain(), "innovation")


@pytest.mark.parametrize("how", ["frozen", "zero", "dead"])
@pytest.mark.parametrize("signal", USED)
def test_a_lost_signal_is_not_judged_and_told(signal: Signal, how: str) -> None:
    def spoil(t_ns: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
        late = t_ns > t_ns[0] + SINCE_NS
        if how == "dead":
            return t_ns[~late], values[~late]
        values[late] = 0.0 if how == "zero" else values[late.argmax()]
        return t_ns, values

    found = judged(changed(calm(), signal, spoil))
    assert not [one for one in found.changes if str(one.stage) == "fault"]
    assert judged_s(found, USED[signal]) < judged_s(plain(), USED[signal]) - 12.5  # of 14 s, 1 s and a tick less
    if signal is not Signal.BODY_RATE:
        told = next(one.not_judged for one in found.monitors if one.name == USED[signal])
        assert told == f"no {signal.replace('_', ' ')}"
    elif how != "dead":
        assert {one.not_judged for one in found.monitors if one.name in USED.values()} == {"gyro repeats one value"}


def stop_pitch(t_ns: IntArray, values: FloatArray) -> None:
    values[AT:, 1] = values[AT, 1]


def jitter(t_ns: IntArray, values: FloatArray, since: int = 0) -> tuple[IntArray, FloatArray]:
    shifts = np.random.default_rng(3).exponential(0.5 * DT_NS, len(t_ns)) * (np.arange(len(t_ns)) >= since)
    return t_ns + np.round(shifts).astype(np.int64), values


@pytest.mark.parametrize(
    ("change", "told", "most_s"),
    [
        (stop_pitch, "gyro repeats one value", 17.0),
        (jitter, "uneven time stamps", 0.2),
        (partial(jitter, since=AT), "uneven time stamps", 15.2),
        (lambda t_ns, values: (t_ns, 0.02 * np.round(values / 0.02)), "gyro resolution", 2.5),
    ],
    ids=["one dead axis", "jitter", "late jitter", "coarse"],
)
def test_a_gyro_that_cannot_be_believed_is_not_judged(change: Change, told: str, most_s: float) -> None:
    found = judged(changed(calm(), Signal.BODY_RATE, change))
    assert not [one for one in found.changes if str(one.stage) == "fault"]
    assert told in {one.not_judged for one in found.monitors if one.name == "innovation"} or "link" in found.reason
    assert judged_s(found, "innovation") < most_s if found.monitors else True


def test_the_same_samples_are_believed_live_and_in_a_log() -> None:
    rng, log = np.random.default_rng(5), calm()
    for signal in (Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ATTITUDE_SETPOINT):

        def strike(t_ns: IntArray, values: FloatArray) -> None:
            for at in rng.integers(0, len(values) - 3, 20).tolist():
                values[at : at + rng.integers(1, 5), rng.integers(3)] = 30.0
            t_ns[rng.integers(0, len(t_ns), 5)] += 700_000_000

        log = changed(log, signal, strike)
    edges = np.sort(rng.integers(1_000_000_000, 31_000_000_000, 60)).tolist()
    watch, alone = md.Watch(whole()), md.Watch(whole())
    live = [str(one) for piece in cut(log.telemetry, edges) for one in watch.step(piece)]
    assert sorted(live) == sorted(str(one) for one in alone.step(log.telemetry))
    assert watch.diagnosis.stage == alone.diagnosis.stage


def turning(n: int = 3000, seed: int = 11) -> Series:
    """A set-point at 100 Hz that swings at up to 0.6 rad/s, 6 mrad a sample, and hardly bends."""
    t_ns = 10_000_000 * np.arange(n, dtype=np.int64)
    phase = 2.0 * np.pi * 0.5 * t_ns[:, None] / 1e9 + np.array([0.0, 1.0, 2.0])
    values = 0.19 * np.sin(phase) + np.random.default_rng(seed).normal(0, 2e-5, (n, 3))
    return Series(Signal.ATTITUDE_SETPOINT, t_ns, t_ns, values)


@cache
def smooth() -> LinkQuality:
    series = turning()
    return learnt_quality([(Telemetry((series,)), [(int(series.t_ns[0]), int(series.t_ns[-1]))])])


def kept(values: FloatArray, pieces: int = 1) -> set[int]:
    """Numbers of the samples that are believed, of those that came in so many pieces, 5 ms before the gyro's."""
    series, spec = turning(), AlignSpec(0.01, quality=smooth())
    state, numbers = spec.start(), set[int]()
    for places in np.array_split(np.arange(len(values)), pieces):
        t_ns = series.t_ns[places]
        spec.append(state, [Telemetry((Series(series.signal, t_ns, t_ns, values[places]),))])
        spec.take(state)
        place = PLACES[series.signal]
        first, last = state.streams.marks[place, [LO, HI]]
        numbers |= {int(one) // 10_000_000 for one in state.streams.times[place][first:last]}
    return numbers


@pytest.mark.parametrize(("error", "samples"), [(0.003, 1), (-0.008, 1), (2.0, 1), (0.03, 2), (-0.08, 2), (0.5, 3)])
@pytest.mark.parametrize("at", [1000, 1025, 1050])  # through a swing
def test_a_fast_set_point_hides_no_error_of_the_size_of_its_steps(at: int, error: float, samples: int) -> None:
    values = turning().values.copy()
    values[at : at + samples, 0] += error
    assert set(range(len(values))) - kept(values) == set(range(at, at + samples))


def test_what_was_learnt_believes_all_of_its_own_log_and_not_an_error_in_it() -> None:
    series, values = turning(), turning().values.copy()
    values[1000, 0] += 2.0
    wrong = Telemetry((Series(series.signal, series.t_ns, series.t_ns, values),))
    assert adds_nothing(smooth(), [Telemetry((series,))])
    assert not adds_nothing(smooth(), [wrong])
    assert adds_nothing(LinkQuality(), [wrong])


@pytest.mark.parametrize(("signal", "used"), [(Signal.HEIGHT, 79), (Signal.ROTOR_SPEED, 1)])
def test_a_stream_in_any_order_or_slower_is_used_but_no_slower_rotor_speeds(signal: Signal, used: int) -> None:
    series = replace(turning(), signal=signal, values=turning().values[:, : signal.width or 3])
    quality = learnt_quality([(Telemetry((series,)), [(0, int(series.t_ns[-1]))])])
    mixed = np.argsort(np.arange(3000) + 2.9 * np.random.default_rng(1).random(3000))  # by up to 20 ms
    for order, count in ((mixed, 3000), (np.r_[:1000, 1000:3000:25], 1000 + used)):
        assert len(believed(quality, Telemetry((series.where(order),))).need(signal)) == count


@pytest.mark.parametrize("leaps", [1.2, 1.8, 2.4, 10.0])
def test_a_corner_and_a_step_of_the_set_point_and_what_leaps_and_goes_on_are_motion(leaps: float) -> None:
    values, leap = turning().values.copy(), smooth().habits[0].limits([0])[0]
    values[1000:, 0] += leaps * leap * np.arange(1, len(values) - 999)
    assert kept(values) == set(range(len(values)))
    values = turning().values.copy()
    values[1000:1300, 0] += 0.3
    values[1300:, 0] += 0.01 * np.arange(len(values) - 1300)
    assert len(set(range(len(values))) - kept(values)) <= 1
