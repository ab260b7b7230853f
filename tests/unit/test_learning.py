"""Learning: what is refused, shared, told, kept on disk; sessions of flights; and more flights for a baseline."""

import dataclasses
import errno
import io
import itertools
import json
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying, without
from hypothesis import given, settings
from hypothesis import strategies as st
from made_baselines import ALWAYS, FRAME, NOW, healthy, plain, whole
from made_monitor import MadeUp
from made_rows import example_rows
from made_telemetry import changed, flight

import mavdiag.chain
import mavdiag.kernel
import mavdiag.monitors
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import SESSION_GAP_NS, Baseline, MonitorEntry, Refusal, dump, parse
from mavdiag.chain import chain_of, front_of
from mavdiag.errors import BaselineError, InputError, UsageError
from mavdiag.judging import Verdict, judge
from mavdiag.kernel import compiled, joined_loops
from mavdiag.learning import ALL_MONITORS, LearnOptions, airborne, extend, learn, thesis_options, warm
from mavdiag.learning.coaching import Coverage
from mavdiag.learning.flights import sessions_of
from mavdiag.monitors import by_name, monitor_of
from mavdiag.monitors.base import Monitor
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.rows.conditions import Condition
from mavdiag.storage import Shelf
from mavdiag.telemetry import Log, Signal, Telemetry
from mavdiag.thresholds.envelope import ORDER
from mavdiag.thresholds.heldout import folds
from mavdiag.thresholds.rule import poisson_upper
from mavdiag.units import NS_PER_S

UNKNOWN = Airframe(gate=ALWAYS)
ROLL = dataclasses.replace(thesis_options(), airframe=UNKNOWN)
HALVED = Telemetry(tuple(s.where(slice(None, None, 2)) for s in flight(8000, 2).series))
MONDAY = 1_777_600_000 * NS_PER_S
HOUR = 3600 * NS_PER_S
FSD, TRIM = 0, 5  # places in the list of the monitors
Ran = tuple[int, str, str]


def made(seed: int, telemetry: Telemetry | None = None, profile: str = "qdrone2") -> Log:
    return Log(f"f{seed}", f"{seed:064x}", profile, telemetry or flight(8000, seed))


@pytest.mark.parametrize(
    ("logs", "says"),
    [([made(7, without(flight(8000, 7), (0.0, 99.0), signals=[Signal.BODY_RATE]))], "f7: no body rate"),
        ([made(3, changed(flight(8000, 3), Signal.ARMED, np.zeros_like))], r"f3: only 0\.0 s .*never armed"),
        ([made(1), made(2, profile="px4")], r"different links \(px4, qdrone2\)"),
        ([made(1), made(2, HALVED)], r"a gyro rate of (1000|500)\.0 Hz, the others have (?!\1)(1000|500)\.0 Hz.*rate$"),
        ([made(1), made(2, HALVED), made(3)], r"f2 has a gyro rate of 500\.0 Hz, the others have 1000\.0 Hz")],  # R8
)  # fmt: skip
def test_flights_that_cannot_teach_are_named(logs: list[Log], says: str) -> None:
    with pytest.raises(InputError, match=says):
        learn(logs, ROLL, created=NOW)
    with pytest.raises(InputError, match=r"f3: only 0\.0 s .*without the first 5 s after a take-off"):
        learn([made(3, flight(4000, 3))], LearnOptions(), created=NOW)
    with pytest.raises(UsageError, match="time 'yesterday': write it like"):
        learn(logs, ROLL, created="yesterday")


@pytest.mark.parametrize(
    ("options", "says"),
    [({"monitors": ("hunch",)}, "no monitor hunch"), ({"monitors": ()}, "no monitor named"),
        ({"flights_per_suspicion": float("inf")}, "a number above 1"), *(
        ({"alarms_per_hour": x}, "must be positive") for x in (0.0, -1.0, np.nan, np.inf)
    )],
)  # fmt: skip
def test_options_that_cannot_be_are_refused(options: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        LearnOptions(**options)  # type: ignore[arg-type]  # wrong on purpose


def test_what_warm_makes_up_can_be_learnt() -> None:
    warm()


def test_b11_one_monitor_s_need_does_not_hinder_another() -> None:
    """B11: no baseline could be made without an ARX model of roll."""
    hover = changed(flying(3000, 1), Signal.ATTITUDE_SETPOINT, np.zeros_like)
    found = learn([made(1, hover, "px4")], LearnOptions(airframe=FRAME, monitors=("rotor_trim",)), created=NOW)
    assert ([entry.spec.kind for entry in found.monitors], found.not_judgeable) == (["rotor_trim"], ())
    both = learn([made(1, hover, "px4")], LearnOptions(airframe=FRAME, monitors=("fsd", "rotor_trim")), created=NOW)
    assert [entry.spec.kind for entry in both.monitors] == ["rotor_trim"]
    assert {one.monitor for one in both.not_judgeable} == {"fsd"}


def test_an_axis_that_one_flight_alone_moves_is_not_scored_on_the_others() -> None:
    """It was: the flight that no fit without it can judge did not count, and the threshold came out as 1e-11 s."""
    flat = [changed(flying(3000, i), Signal.ATTITUDE_SETPOINT, lambda x: x * (1.0, 0.0, 1.0)) for i in (1, 2)]
    flights = [made(0, flying(3000, 0), "px4"), *(made(i, one, "px4") for i, one in enumerate(flat, start=1))]
    found = learn(flights, LearnOptions(airframe=FRAME, monitors=("fsd",)), created=NOW)
    assert [entry.spec.axis for entry in found.monitors] == ["roll"]
    assert [one.reason[:36] for one in found.not_judgeable] == ["pitch: without a part of the flights"]


def test_b18_nothing_is_taken_from_a_vehicle_that_was_not_named() -> None:
    """B18: an unknown vehicle got the layout, the mass and the rotor speed of a QDrone 2."""
    found = learn(plain(2), LearnOptions(airframe=UNKNOWN), created=NOW)
    frame = found.airframe
    assert (frame.name, frame.layout, frame.mass_kg, frame.hover_rad_s, frame.classifier) == ("unnamed", *[None] * 4)
    reasons = {one.monitor: one.reason for one in found.not_judgeable}
    for name in ("rotor_trim", "rotor_signature"):
        assert "layout is not known" in reasons[name], reasons
    assert "unbalance" in reasons


def test_b27_the_budget_is_shared_by_those_that_decide_and_could_be_fitted() -> None:
    """B27: monitors that do not decide, or could not be fitted, took a share of the alarm budget."""
    found = whole()
    assert {one.monitor for one in found.not_judgeable} == {"unbalance"}
    thresholds = {e.spec.kind: e.threshold for e in found.monitors}
    deciding = {name: one for name, one in thresholds.items() if by_name(name).decides}
    assert {*deciding} == {*ALL_MONITORS} - {"fsd", "unbalance"}
    promise = LearnOptions()
    assert sum(one.budget_per_hour for one in deciding.values()) == pytest.approx(promise.alarms_per_hour)
    suspicions = sum(1.0 / e.threshold.flights_per_suspicion for e in found.monitors)
    assert suspicions == pytest.approx(1.0 / promise.flights_per_suspicion)
    least = {name for name, one in deciding.items() if one.value <= (1 + 1e-9) * by_name(name).least}
    common = {deciding[name].budget_per_hour for name in {*deciding} - least}
    assert len(least) > 1
    assert max(common) == pytest.approx(min(common))  # one rate for all that can use it
    assert max(deciding[name].budget_per_hour for name in least) <= 1.001 * min(common)
    assert promise.alarms_per_hour / len(deciding) < min(common) < promise.alarms_per_hour / len(common)
    single = learn(plain(2), LearnOptions(airframe=UNKNOWN, monitors=("fsd",)), created=NOW)
    assert sum(e.threshold.budget_per_hour for e in single.monitors) == pytest.approx(LearnOptions().alarms_per_hour)


def test_b5_the_hours_of_a_threshold_are_the_judged_time_of_its_values() -> None:
    """B5: warm-up and gaps counted as judged healthy time, up to five times too much."""
    flights = [
        dataclasses.replace(log, telemetry=without(log.telemetry, (4.0, 6.0), (13.0, 15.0), (20.0, 21.5)))
        for log in healthy(4)
    ]
    found = learn(flights, LearnOptions(airframe=FRAME), created=NOW)
    front = front_of(found)
    for entry in found.monitors:
        monitor = monitor_of(entry.spec)
        judged_s = sum(one.judged_s for log in flights for one in monitor.over(airborne(front, log).rows))
        assert entry.threshold.hours == pytest.approx(judged_s / 3600, rel=0.01), entry.spec.kind
        shown = poisson_upper(entry.threshold.exceeding) * 3600 / judged_s
        assert entry.threshold.demonstrated_per_hour == pytest.approx(shown, rel=0.01)
    hours = {entry.spec.kind: entry.threshold.hours for entry in found.monitors}
    assert hours["rotor_trim"] < 0.5 * found.healthy_hours  # five seconds of each stretch warm it up


def test_a_new_monitor_is_its_class_and_one_name_in_the_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Learnt, written, read, judged, and its alarm reported, by nothing but its class."""
    registry: tuple[type[Monitor[Any]], ...] = (RotorTrim, MadeUp)  # those of the test: all take a minute to compile
    for module in (mavdiag.monitors, mavdiag.chain, mavdiag.kernel):
        monkeypatch.setattr(module, "MONITORS", registry)
    monkeypatch.setattr(mavdiag.monitors, "BY_NAME", {kind.name: kind for kind in registry})
    monkeypatch.setattr(mavdiag.kernel, "loop", joined_loops([monitor.run for monitor in registry]))
    monkeypatch.setattr(mavdiag.kernel, "judge", compiled())
    options = LearnOptions(airframe=FRAME, monitors=("made_up", "rotor_trim"))
    baseline = parse(dump(learn(healthy(2), options, created=NOW)))
    assert {entry.spec.kind for entry in baseline.monitors} == {"made_up", "rotor_trim"}
    assert Signal.SPECIFIC_FORCE in baseline.needs()
    assert "made_up" in str(baseline)
    heavy = changed(flying(3000, 9), Signal.SPECIFIC_FORCE, lambda force: 1.5 * force)
    verdict = judge(made(9, heavy, "px4"), baseline)
    assert (verdict.verdict, [one.monitor for one in verdict.events]) == (Verdict.FAULT, ["made_up"])
    assert verdict.reason.startswith("made_up")
    assert judge(made(8, flying(3000, 8), "px4"), baseline).verdict is Verdict.HEALTHY


OPTIONS = LearnOptions(airframe=FRAME)
SQUARE = np.arange(9.0).reshape(3, 3)
ARRAYS = (
    np.arange(12.0).reshape(4, 3),
    np.array([True, False, True]),
    np.empty((0, 3)),
    np.arange(7, dtype=np.int64)[::2],
    np.full((20, 2), np.nan),
    *(SQUARE, SQUARE.T, SQUARE.view(np.int64)),  # that begin at one place are not one
)


def assert_alike(found: Any, expected: Any) -> None:
    """Equal, but for rounding: numpy's sums may depend on where an array begins, above AVX2 they do."""
    if isinstance(expected, Baseline):
        found, expected = (json.loads(dump(one)) | {"digest": ""} for one in (found, expected))
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        found, expected = list(found.values()), list(expected.values())
    if isinstance(expected, list):
        assert len(found) == len(expected)
        for part, other in zip(found, expected, strict=True):
            assert_alike(part, other)
    else:
        assert found == (pytest.approx(expected, rel=1e-6, abs=1e-9) if isinstance(expected, float) else expected)


def on_disk(make: Callable[[], Baseline]) -> Baseline:
    """What is learnt if nothing may stay in memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavdiag.storage.SHELF_BYTES", 0)
        return make()


@settings(max_examples=2)
@given(seed=st.integers(0, 99), count=st.integers(1, 2), gap_s=st.sampled_from([0.0, 0.1, 2.0]))
def test_on_disk_the_same_is_learnt_and_extended(seed: int, count: int, gap_s: float) -> None:
    def made(first: int) -> Iterator[Log]:
        for i in range(first, first + count):
            yield Log(f"f{i}", f"{i:064x}", "px4", without(flying(2000, 10 * seed + i), (12.0, 12.0 + gap_s)))

    in_memory = learn(list(made(0)), OPTIONS, created=NOW)
    assert_alike(on_disk(lambda: learn(made(0), OPTIONS, created=NOW)), in_memory)
    assert len(in_memory.monitors) >= 9
    for new in (False, True):
        make = partial(extend, in_memory, new_propellers=new, created=NOW)
        assert_alike(on_disk(lambda make=make: make(made(20))), make(list(made(20))))  # type: ignore[misc]


@pytest.mark.parametrize("rows", [700, 1900])
def test_the_same_is_learnt_however_a_log_is_cut(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavdiag.monitors.run_length.TRAIN_ROWS", 1000)
    uncut = learn(healthy(2), OPTIONS, created=NOW)
    monkeypatch.setattr("mavdiag.learning.flights.PIECE_ROWS", rows)
    assert_alike(learn(healthy(2), OPTIONS, created=NOW), uncut)


def test_what_robust_teaching_leaves_out_is_left_out_on_disk_too() -> None:
    flights, crash = healthy(4), flying(2600, 9)
    (gyro,) = (one for one in crash.series if one.signal == "body_rate")
    gyro.values[2000:2100] += 20.0
    flights = [*flights, flights[1], Log("crash", "9" * 64, "px4", crash)]
    options = LearnOptions(airframe=FRAME, monitors=("innovation", "rotor_trim"), robust=True)
    found = on_disk(lambda: learn(iter(flights), options, created=NOW))
    assert_alike(found, learn(flights, options, created=NOW))
    assert len(found.provenance.left_out) == 2


@pytest.mark.parametrize("most_bytes", [0, 1 << 20])
def test_what_was_put_aside_comes_back_as_often_as_it_is_asked_and_leaves_no_file(
    most_bytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Shelf(most_bytes) as shelf:
        kept = [(shelf.put(arrays), arrays) for arrays in (ARRAYS, ARRAYS[::-1], ())]
        assert list(tmp_path.iterdir()) == []  # not even while it is open
        for get, arrays in (*kept, *kept):
            for found, expected in zip(get(), arrays, strict=True):
                assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
                np.testing.assert_array_equal(found, expected)
        outlives, written_to = kept[0][0](), kept[0][0]()
        if not most_bytes:
            written_to[0][0, 0] += 1.0
            np.testing.assert_array_equal(kept[0][0]()[0], ARRAYS[0])
    np.testing.assert_array_equal(outlives[0], ARRAYS[0])


def test_a_full_disk_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.BytesIO):
        def write(self, _: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: Full())
    with Shelf(0) as shelf, pytest.raises(UsageError, match=r"No space left on device.*set TMPDIR"):
        shelf.put(ARRAYS)


def logs(*started_ns: int) -> list[Log]:
    return [Log(f"f{i}", "", "px4", Telemetry(), started_ns=t) for i, t in enumerate(started_ns)]


@pytest.mark.parametrize(
    ("started", "sessions"),
    [
        ([], []),
        ([MONDAY], [0]),
        ([MONDAY, MONDAY + HOUR], [0, 0]),
        ([MONDAY, MONDAY + HOUR + 1], [0, 1]),
        ([MONDAY, MONDAY + HOUR, MONDAY + 2 * HOUR], [0, 0, 0]),  # each an hour after the one before
        ([MONDAY + 24 * HOUR, MONDAY, MONDAY + 25 * HOUR], [1, 0, 1]),  # numbered by time, whatever the order
        ([0, 60, HOUR], [0, 1, 2]),  # unknown, or never set: each for itself
        ([MONDAY, 0, MONDAY + 60], [1, 0, 1]),
    ],
)
def test_the_wall_clock_tells_the_sessions(started: list[int], sessions: list[int]) -> None:
    assert (sessions_of(logs(*started)), sessions_of(logs(*[MONDAY] * 5), 2)) == (sessions, [0, 0, 0, 1, 1])  # or told


@pytest.mark.parametrize(("flights", "each", "count"), [(12, 2, 6), (30, 2, 10), (50, 1, 5)])
def test_of_many_sessions_a_tenth_or_a_fifth_is_left_out_always_whole_ones(flights: int, each: int, count: int) -> None:
    sessions, numbered = [i // each for i in range(flights)], [[example_rows(500, segment=i)] for i in range(flights)]
    found = [[[one[0].block.segment for one in part] for part in parts] for parts in folds(numbered, sessions=sessions)]
    assert len(found) == count
    assert sorted(itertools.chain.from_iterable(out for out, _ in found)) == list(range(flights))
    for out, rest in found:
        assert not {sessions[i] for i in out} & {sessions[i] for i in rest}
        assert sorted(out + rest) == list(range(flights))


@cache
def two_days(first_ns: int = MONDAY) -> Baseline:
    flights = [flown(i, first_ns + (i // 2) * 24 * HOUR + (i % 2) * HOUR // 6) for i in range(4)]
    return learn(flights, LearnOptions(airframe=FRAME, monitors=("rotor_trim", "trim_step")), created=NOW)


def test_a_baseline_knows_the_sessions_of_its_flights() -> None:
    made = two_days()
    assert [one.session for one in made.provenance.logs] == [0, 0, 1, 1]
    assert ({entry.threshold.sessions for entry in made.monitors}, two_days(HOUR).same_session(HOUR)) == ({2}, False)
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


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("link", "dt_s"), -1.0, "link.dt_s"),
        (("link", "gate", "colour"), 1.0, "link.gate"),
        (("link", "gate", "min_thrust"), 7.0, "link.gate.min_thrust"),
        (("window", "samples"), 100, "window"),
        (("link_quality", "habits", 0, "period_s"), 0.0, "link_quality.habits.0.period_s"),
        (("monitors", FSD, "spec", "model", "a"), [1.0], "monitors.0.spec"),
        (("monitors", FSD, "spec", "delay_s"), 1e308, "monitors.0.spec"),
        (("monitors", TRIM, "spec", "window_s"), 1e6, "monitors.5.spec.window_s"),
        (("monitors", TRIM, "spec", "layout", "name"), "of another", "baseline: monitors.5.spec.layout"),
        (("monitors", FSD, "threshold", "value"), "long", "monitors.0.threshold.value"),
        (("monitors", FSD, "threshold", "rule"), "hunch", "monitors.0.threshold.rule"),
        (("monitors", FSD, "threshold", "value"), -1.0, "monitors.0.threshold"),
        (("monitors", FSD, "threshold", "session_allowance"), 9.0, "monitors.0.threshold"),
        (("monitors", FSD, "threshold", "suspected"), [-1.0, 1.0], "monitors.0.threshold"),
        (("monitors", FSD, "threshold", "flights_per_suspicion"), 0.0, "monitors.0.threshold"),
        (("monitors", FSD, "spec", "model", "a"), [1.0, -3.0, 0.5], "monitors.0.spec"),  # it is unstable
        (("monitors", TRIM, "scores", "flights", 0), 7, "baseline: monitors.5.scores.flights"),
        (("monitors",), [], "monitors"),
        (("provenance", "logs"), [], "provenance.logs"),
        (("provenance", "logs", 0, "sha256"), "abc", "provenance.logs.0.sha256"),
        (("provenance", "logs", 0, "trim"), [0.1], "provenance.logs.0.trim"),
        (("airframe", "colour"), "red", "airframe"),
        (("airframe", "name"), "another", "digest"),
        (("not_judgeable", 0, "reason"), 3, "not_judgeable.0.reason"),
        (("monitors", FSD, "spec", "kind"), "hunch", "monitors.0.spec: no monitor hunch"),
        (("monitors", FSD, "spec", "kind"), ["fsd"], "monitors.0.spec"),
        (("monitors", TRIM, "spec", "layout", "signs"), [[1.0, 1.0, 1.0]], "monitors.5.spec"),
        (("monitors", TRIM, "spec", "layout"), "x", "monitors.5.spec.layout"),
        (("airframe", "layout", "signs"), [[1.0, 1.0, 1.0]], "airframe"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(path: tuple[str | int, ...], value: object, field: str) -> None:
    raw: Any = json.loads(dump(whole()))
    place = raw
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    with pytest.raises(BaselineError) as refused:
        parse(json.dumps(raw))
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(field)


@given(st.text(max_size=40), st.integers(0, 400))
def test_garbage_in_the_middle_never_raises_anything_else(garbage: str, at: int) -> None:
    text = dump(whole())
    with pytest.raises(BaselineError):
        parse(text[: at * 5] + "\x00" + garbage + text[at * 5 :])


DAY = 24 * 3600 * NS_PER_S
LATER = "2026-02-02T00:00:00+00:00"
FIVE = LearnOptions(
    airframe=FRAME, monitors=("innovation", "rotor_signature", "vibration_level", "rotor_trim", "trim_step")
)
YAW = layout_named("x").mixing[:, 2]  # what each rotor does to yaw
OTHER_SET = 0.03 * YAW  # of the hover command: thrusts within 3 %, all of them for yaw


def flown(seed: int, started_ns: int = 0, telemetry: Telemetry | None = None) -> Log:
    made = flying(2500, seed) if telemetry is None else telemetry
    return Log(f"f{seed}", f"{seed:064x}", "px4", made, started_ns=started_ns)


def reset(seed: int, n: int = 2500, weak_rotor: int = 0) -> Telemetry:
    """A flight with the other propellers: another trim, and a fifth more vibration."""
    made = flying(n, seed, weak_rotor=weak_rotor, rise=0.3 if weak_rotor else 0.0)
    other = changed(made, Signal.ACTUATOR, lambda outputs: outputs + 0.5 * OTHER_SET)
    return changed(other, Signal.VIBRATION, lambda level: 1.2 * level)


@cache
def monday() -> Baseline:
    return learn([flown(i, MONDAY + i * 600 * NS_PER_S) for i in range(3)], FIVE, created=NOW)


@cache
def tuesday() -> Baseline:
    return extend(monday(), [flown(i, MONDAY + DAY + i * 600 * NS_PER_S) for i in (10, 11)], created=LATER)


def turned(seed: int, n: int = 2500) -> Telemetry:
    """A flight whose nose turns all the time, and which takes no trim for it."""
    made = flying(n, seed, turn=np.full(n, 0.9))
    return changed(made, Signal.ACTUATOR, lambda outputs: outputs - 0.5 * 0.02 * 0.9 * YAW)


def entry(baseline: Baseline, kind: str) -> MonitorEntry:
    return next(one for one in baseline.monitors if one.spec.kind == kind)


def test_a_new_session_is_added_to_what_supports_the_thresholds() -> None:
    before, after = monday(), tuesday()
    assert [one.session for one in after.provenance.logs] == [0, 0, 0, 1, 1]
    assert after.provenance.logs[:3] == before.provenance.logs
    assert after.healthy_hours > before.healthy_hours
    assert after.promised == pytest.approx(before.promised)
    for old, new in zip(before.monitors, after.monitors, strict=True):
        assert (old.threshold.sessions, new.threshold.sessions) == (1, 2)
        assert (old.threshold.flights, new.threshold.flights) == (3, 5)
        assert new.threshold.hours > old.threshold.hours
        kept = np.array(new.scores.maxima[: len(old.scores.maxima)]) - old.scores.maxima
        assert 0 <= kept.min() == pytest.approx(kept.max(), abs=1e-6)  # what the mean moved


def test_it_widens_the_envelope() -> None:
    wider = extend(monday(), [flown(12, MONDAY + DAY, turned(12))], created=NOW)
    (old,), (new,) = (
        [one for one in made.envelope if one.condition is Condition.YAW_RATE] for made in (monday(), wider)
    )
    assert new.high > 0.9 > 1.5 * old.high
    assert {one.condition for one in wider.envelope} == {one.condition for one in monday().envelope}
    turning = Log("t", "", "px4", turned(30, 3000))
    silent = {one.name for one in judge(turning, monday()).monitors if one.outside_s > 10}
    assert {"innovation", "rotor_trim", "trim_step"} <= silent
    found = judge(turning, wider)
    assert found.verdict is Verdict.HEALTHY
    assert not any(one.outside_s for one in found.monitors)


def test_a_flight_of_a_session_that_is_in_already_joins_that_one() -> None:
    """And not the last one of the baseline."""
    made = extend(tuesday(), [flown(13, MONDAY + 1800 * NS_PER_S), flown(14), flown(15, MONDAY + 9 * DAY)], created=NOW)
    first, unknown, new = (one.session for one in made.provenance.logs[-3:])
    assert (first, len({0, 1, unknown, new}), entry(made, "rotor_trim").threshold.sessions) == (0, 4, 4)


def test_flights_that_are_added_count_as_if_they_had_been_learnt_with_the_others() -> None:
    """At once or one by one, and chained to a session by those between."""

    def other(seed: int, minute: int) -> Log:
        return flown(seed, MONDAY + minute * HOUR // 60, changed(flying(2500, seed), Signal.ACTUATOR, shift))

    def shift(outputs: Any) -> Any:
        return outputs + 0.5 * 0.008 * YAW

    first, new = [flown(i, MONDAY + i * 600 * NS_PER_S) for i in range(3)], [other(20, 70), other(21, 125)]
    whole, once = learn([*first, *new], FIVE, created=NOW), extend(monday(), new, created=NOW)
    for made in (once, extend(extend(monday(), new[:1], created=NOW), new[1:], created=NOW)):
        for one in (made, whole):
            assert {log.session for log in one.provenance.logs} == {0}
        np.testing.assert_allclose(entry(made, "rotor_trim").spec.mean, entry(whole, "rotor_trim").spec.mean, atol=2e-4)


def test_a_baseline_that_judges_no_propellers_is_of_the_worst_grade() -> None:
    made = learn(healthy(1), LearnOptions(airframe=FRAME, monitors=("control_loss", "thrust_loss")), created=NOW)
    assert (made.grade, "none of its monitors judges propellers" in made.weak) == ("D", True)


def test_what_speaks_against_a_baseline_stays_when_a_sound_flight_is_added() -> None:
    blind = Refusal(monitor="rotor_trim", reason="its threshold 0.6 fraction of hover cannot be reached")
    deaf = [one for one in monday().monitors if one.spec.kind not in ("rotor_trim", "trim_step")]
    for update in ({"weak": "f1: broken?", "grade": "D"}, {"monitors": tuple(deaf), "not_judgeable": (blind,)}):
        made = extend(monday().model_copy(update=update), [flown(10, MONDAY + DAY)], created=NOW)
        assert (made.grade, made.weak) == ("D", update.get("weak", ""))


def test_a_flight_that_is_in_it_already_or_of_another_link_is_refused() -> None:
    for logs, says in (
        ((flown(10), flown(2)), r"f2: is in the baseline already; leave it out"),
        ((flown(10), flown(10)), r"f10: the same file as f10; take this log out"),  # `extend` has no --robust
        ((dataclasses.replace(flown(10), profile="spec"),), r"f10: link\.profile: .* of this kind"),
    ):
        with pytest.raises(InputError, match=f"^{says}$"):
            extend(monday(), logs, created=NOW)


@cache
def refitted() -> Baseline:
    """With new propellers, after a hover of 16 s."""
    return extend(monday(), [flown(40, MONDAY + DAY, reset(40, 1600))], new_propellers=True, created=LATER)


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_new_propellers_are_healthy_after_one_short_hover_and_a_weak_motor_is_still_found(rotor: int) -> None:
    healthy = Log("h", "", "px4", reset(40 + rotor, 3000), started_ns=MONDAY + 3 * DAY)
    assert judge(healthy, monday()).verdict is not Verdict.HEALTHY  # or there is nothing to show
    found = judge(healthy, refitted())
    assert found.verdict is Verdict.HEALTHY, found.reason
    assert {"rotor_trim", "vibration_level"} <= {one.name for one in found.monitors if one.judged_s > 10}
    found = judge(Log("w", "", "px4", reset(50 + rotor, 3000, rotor), started_ns=MONDAY + 3 * DAY), refitted())
    assert found.verdict is Verdict.FAULT
    assert f"rotor {rotor}" in found.reason


def test_new_propellers_change_the_level_and_nothing_else() -> None:
    old, new = monday(), refitted()
    assert [one.propellers for one in new.provenance.logs] == [0, 0, 0, 1]
    assert not new.same_session(MONDAY)
    assert new.same_session(MONDAY + DAY)
    moved = np.array(entry(new, "rotor_trim").spec.mean) - np.array(entry(old, "rotor_trim").spec.mean)
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.03], atol=0.003)
    for was, now in ((entry(old, kind).spec, entry(new, kind).spec) for kind in ("rotor_trim", "trim_step")):
        assert now == dataclasses.replace(was, mean=now.mean, about=now.about)
    ratio = entry(new, "vibration_level").spec.healthy / entry(old, "vibration_level").spec.healthy
    assert ratio == pytest.approx(1.2, rel=0.05)
    for kind in ("innovation", "rotor_signature"):
        assert entry(new, kind).spec == entry(old, kind).spec
    assert parse(dump(new)) == new


def test_the_command_adds_flights(mavdiag: Callable[..., Ran], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log's name says which flight it holds."""
    monkeypatch.setattr("mavdiag.commands.identify.read_part", lambda path, *_: flown(int(path.stem[1:]), MONDAY + DAY))
    monkeypatch.setattr("mavdiag.commands.progress.SLOW_S", 1e6)  # nothing is said of a slow machine
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    monday().save(old)
    code, out, err = mavdiag("baseline", "extend", old, "f10.tlog", "f11.tlog", "-o", new)
    assert (code, err) == (0, "")
    assert out.endswith(f"written to {new}\n")
    assert "from 5 flights in 2 sessions" in out
    assert "support    5 flights" in out
    assert [one.name for one in Baseline.load(new).provenance.logs] == ["f0", "f1", "f2", "f10", "f11"]
    assert Baseline.load(old) == monday()


def test_a_square_that_is_flown_nose_first_is_a_square_too(monkeypatch: pytest.MonkeyPatch) -> None:
    second = SimpleNamespace(end_ns=np.arange(1, 11) * NS_PER_S // 10, values=np.ones((10, len(ORDER))))
    monkeypatch.setattr("mavdiag.learning.coaching.measure", lambda rows: [second])
    assert (coverage := Coverage()).take(())
    assert list(coverage.flown_s.values()) == [0, 1, 1]
