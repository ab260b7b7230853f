"""Learning from healthy flights: what it needs, and what it says when it does not get it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying, without
from made_baselines import ALWAYS, FRAME, NOW, healthy, plain, whole
from made_monitor import MadeUp
from made_telemetry import changed, flight

import mavdiag.chain
import mavdiag.kernel
import mavdiag.monitors
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import dump, parse
from mavdiag.chain import front_of
from mavdiag.errors import IdentificationError, InputError, UsageError
from mavdiag.judging import Verdict, judge
from mavdiag.kernel import compiled, joined_loops
from mavdiag.learning import ALL_MONITORS, LearnOptions, airborne, learn, thesis_options
from mavdiag.monitors import by_name, monitor_of
from mavdiag.monitors.base import Monitor
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.telemetry import Log, Signal, Telemetry
from mavdiag.thresholds.rule import poisson_upper

UNKNOWN = Airframe(gate=ALWAYS)
ROLL = thesis_options(UNKNOWN)


def made(seed: int, telemetry: Telemetry | None = None, profile: str = "qdrone2") -> Log:
    return Log(f"f{seed}", f"{seed:064x}", profile, telemetry or flight(8000, seed))


def refusal(seed: int, telemetry: Telemetry) -> str:
    with pytest.raises(IdentificationError) as error:
        learn([made(seed, telemetry)], ROLL, created=NOW)
    return str(error.value)


def test_a_missing_gyro_is_named_with_the_flight() -> None:
    with pytest.raises(InputError, match="f7: no body rate"):
        learn([made(7, without(flight(8000, 7), (0.0, 99.0), signals=[Signal.BODY_RATE]))], ROLL, created=NOW)


def test_a_flight_on_the_ground_is_refused() -> None:
    with pytest.raises(InputError, match=r"f3: only 0\.0 s of airborne flight"):
        learn([made(3, changed(flight(8000, 3), Signal.ARMED, np.zeros_like))], ROLL, created=NOW)


def test_flights_of_different_links_are_not_mixed() -> None:
    with pytest.raises(InputError, match=r"different links \(px4, qdrone2\)"):
        learn([made(1), made(2, profile="px4")], ROLL, created=NOW)


def test_r8_a_flight_of_another_rate_is_named() -> None:
    """R8: the refusal did not name the file."""
    parts = tuple(s.where(slice(None, None, 2)) for s in flight(8000, 2).series)
    with pytest.raises(InputError, match=r"f2 has a gyro rate of 500\.0 Hz, the others have 1000\.0 Hz"):
        learn([made(1), made(2, Telemetry(parts)), made(3)], ROLL, created=NOW)


def test_a_reversed_gyro_is_noticed() -> None:
    assert "the gyro turns against its set-point" in refusal(1, changed(flight(8000, 1), Signal.BODY_RATE, np.negative))


@pytest.mark.parametrize(
    ("options", "says"),
    [({"monitors": ("hunch",)}, "no monitor hunch"), ({"monitors": ()}, "no monitor named"), *(
        ({"alarms_per_hour": x}, "must be positive") for x in (0.0, -1.0, float("nan"))
    )],
)  # fmt: skip
def test_options_that_cannot_be_are_refused(options: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        LearnOptions(**options)  # type: ignore[arg-type]  # wrong on purpose


def test_b11_one_monitor_s_need_does_not_hinder_another() -> None:
    """B11: no baseline could be made without an ARX model of roll."""
    hover = changed(flying(3000, 1), Signal.ATTITUDE_SETPOINT, np.zeros_like)
    found = learn([made(1, hover, "px4")], LearnOptions(airframe=FRAME, monitors=("rotor_trim",)), created=NOW)
    assert [entry.spec.kind for entry in found.monitors] == ["rotor_trim"]
    assert found.not_judgeable == ()
    both = learn([made(1, hover, "px4")], LearnOptions(airframe=FRAME, monitors=("fsd", "rotor_trim")), created=NOW)
    assert [entry.spec.kind for entry in both.monitors] == ["rotor_trim"]
    assert {one.monitor for one in both.not_judgeable} == {"fsd"}


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
    monkeypatch.setattr(mavdiag.monitors, "MONITORS", registry)
    monkeypatch.setattr(mavdiag.monitors, "BY_NAME", {kind.name: kind for kind in registry})
    monkeypatch.setattr(mavdiag.chain, "MONITORS", registry)
    monkeypatch.setattr(mavdiag.kernel, "MONITORS", registry)
    monkeypatch.setattr(mavdiag.kernel, "loop", joined_loops([monitor.run for monitor in registry]))
    monkeypatch.setattr(mavdiag.kernel, "judge", compiled())
    options = LearnOptions(airframe=FRAME, monitors=("made_up", "rotor_trim"))
    baseline = parse(dump(learn(healthy(2), options, created=NOW)))
    assert {entry.spec.kind for entry in baseline.monitors} == {"made_up", "rotor_trim"}
    assert Signal.SPECIFIC_FORCE in baseline.needs()
    assert "made_up" in str(baseline)
    heavy = changed(flying(3000, 9), Signal.SPECIFIC_FORCE, lambda force: 1.5 * force)
    verdict = judge(made(9, heavy, "px4"), baseline)
    assert verdict.verdict is Verdict.FAULT
    assert [one.event.monitor for one in verdict.events] == ["made_up"]
    assert verdict.reason.startswith("made_up")
    assert judge(made(8, flying(3000, 8), "px4"), baseline).verdict is Verdict.HEALTHY
