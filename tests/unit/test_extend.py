"""More healthy flights for a baseline: a new session, new propellers, and what is refused."""

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import FRAME, NOW
from made_telemetry import changed

from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import Baseline, MonitorEntry, dump, parse
from mavdiag.errors import BaselineError, InputError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.learning.learn import extend
from mavdiag.rows.conditions import Condition
from mavdiag.telemetry import Log, Signal, Telemetry
from mavdiag.units import NS_PER_S

MONDAY = 1_777_600_000 * NS_PER_S
DAY = 24 * 3600 * NS_PER_S
LATER = "2026-02-02T00:00:00+00:00"
OPTIONS = LearnOptions(
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
    return learn([flown(i, MONDAY + i * 600 * NS_PER_S) for i in range(3)], OPTIONS, created=NOW)


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
        assert new.scores.maxima[: len(old.scores.maxima)] == old.scores.maxima


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
    assert first == 0
    assert len({0, 1, unknown, new}) == 4
    assert entry(made, "rotor_trim").threshold.sessions == 4


def refusal(baseline: Baseline, *flights: Log) -> str:
    with pytest.raises((InputError, BaselineError)) as error:
        extend(baseline, flights, created=NOW)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_flight_that_is_in_it_already_is_refused() -> None:
    assert refusal(monday(), flown(10), flown(2)) == "f2: is in the baseline already; leave it out"


@cache
def refitted() -> Baseline:
    """With new propellers, after a hover of 16 s."""
    hover = flown(40, MONDAY + DAY, reset(40, 1600))
    return extend(monday(), [hover], new_propellers=True, created=LATER)


@pytest.mark.parametrize("seed", range(41, 45))
def test_new_propellers_are_healthy_after_one_short_hover(seed: int) -> None:
    healthy = Log("h", "", "px4", reset(seed, 3000), started_ns=MONDAY + 3 * DAY)
    assert judge(healthy, monday()).verdict is not Verdict.HEALTHY  # or there is nothing to show
    found = judge(healthy, refitted())
    assert found.verdict is Verdict.HEALTHY, found.reason
    assert {"rotor_trim", "vibration_level"} <= {one.name for one in found.monitors if one.judged_s > 10}


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_weak_motor_is_still_found_with_them(rotor: int) -> None:
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
    for kind in ("rotor_trim", "trim_step"):
        level = entry(new, kind).spec.mean
        assert entry(new, kind).spec == dataclasses.replace(entry(old, kind).spec, mean=level)
    ratio = entry(new, "vibration_level").spec.healthy / entry(old, "vibration_level").spec.healthy
    assert ratio == pytest.approx(1.2, rel=0.05)
    for kind in ("innovation", "rotor_signature"):
        assert entry(new, kind).spec == entry(old, kind).spec
    assert parse(dump(new)) == new


Ran = tuple[int, str, str]


@pytest.fixture(autouse=True)
def made_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """The content of files is made here: a log's name says which flight it holds."""

    def read(path: Path, *_: object) -> Log:
        seed = int(path.stem.removeprefix("f"))
        return flown(seed, MONDAY + DAY, reset(seed, 1600) if path.suffix == ".hover" else None)

    monkeypatch.setattr("mavdiag.commands.identify.read_part", read)
    monkeypatch.setattr("mavdiag.commands.progress.SLOW_S", 1e6)  # nothing is said of a slow machine


def test_the_command_adds_flights(mavdiag: Callable[..., Ran], tmp_path: Path) -> None:
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    monday().save(old)
    code, out, err = mavdiag("baseline", "extend", old, "f10.tlog", "f11.tlog", "-o", new)
    assert (code, err) == (0, "")
    assert out.endswith(f"written to {new}\n")
    assert "from 5 flights in 2 sessions" in out
    assert "support    5 flights" in out
    made = Baseline.load(new)
    assert [one.name for one in made.provenance.logs] == ["f0", "f1", "f2", "f10", "f11"]
    assert Baseline.load(old) == monday()
    folder = tmp_path / "flights"
    folder.mkdir()
    for name in ("f10.tlog", "f11.tlog"):
        (folder / name).write_bytes(b"\xfd" * 100)
    code, out, err = mavdiag("baseline", "extend", old, folder, "-o", new)
    assert (code, err) == (0, "")
    assert Baseline.load(new).provenance.logs == made.provenance.logs
