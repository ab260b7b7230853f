"""Guards: each made-up case of teaching is refused with its reason, or left out; another vehicle is said to be one."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from made_baselines import ALWAYS, FRAME, NOW, healthy, logged, whole
from made_telemetry import changed as changed_telemetry

from mavdiag.airframe.fingerprint import TRAITS, Fingerprint, Likeness, Outcome, compare, fingerprint_of, joined, traits
from mavdiag.airframe.layout import layout_named
from mavdiag.errors import InputError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, airborne, extend, front_for, learn
from mavdiag.learning.teaching import far_blocks, repeated, taught, upsets
from mavdiag.logs import between
from mavdiag.rows.answer import Answer
from mavdiag.rows.block import COMMANDED, OUTPUTS, Block, U, Y
from mavdiag.telemetry import FloatArray, Log, Signal, Telemetry

OPTIONS = LearnOptions(airframe=FRAME, monitors=("rotor_trim",))
ROBUST = replace(OPTIONS, robust=True)
Change = Callable[[FloatArray], FloatArray]


def changed(log: Log, signal: Signal, from_s: float, to_s: float, change: Change) -> Log:
    """The log with the values of a signal changed between two times since its start."""
    return replace(log, telemetry=changed_telemetry(log.telemetry, signal, change, from_s, to_s))


TUMBLING, OVER = np.array([7.0, 0.0, 0.0]), np.array([2.5, 0.0, 0.0])
UPSETS: tuple[tuple[Signal, Change, str], ...] = (
    (Signal.SPECIFIC_FORCE, lambda force: 0.1 * force, "free fall, specific force 0.1"),
    (Signal.BODY_RATE, lambda rate: rate + TUMBLING, "it turns at"),
    (Signal.ATTITUDE, lambda angle: angle + OVER, "deg from its set-point"),
    (Signal.SPECIFIC_FORCE, np.negative, "upside down, specific force 1.0 g"),
)


@pytest.mark.parametrize(("signal", "change", "says"), UPSETS)
def test_a_log_that_ends_in_a_fall_is_refused_with_place_and_remedy(signal: Signal, change: Change, says: str) -> None:
    crash = changed(healthy(1)[0], signal, 27.0, 30.0, change)
    told = f"flight0: the flight ends in an upset, at 2[78].*{says}.*cut the log before 2[56].*--robust"
    with pytest.raises(InputError, match=told):
        learn([crash, *healthy(3)[1:]], OPTIONS, created=NOW)
    baseline = learn([crash, *healthy(3)[1:]], ROBUST, created=NOW)
    assert ["flight0, all from 2" in one for one in baseline.provenance.left_out] == [True]
    assert len(baseline.provenance.logs) == 3
    whole = learn(healthy(3), OPTIONS, created=NOW).provenance.logs[0].judged_s
    assert baseline.provenance.logs[0].judged_s == pytest.approx(whole - 4, abs=1.5)
    assert "left out   flight0" in str(baseline)


def test_the_spike_of_a_landing_is_no_crash() -> None:
    """8 to 11 rad/s for some tens of milliseconds at touch-down (METHOD section 5)."""
    landed = changed(healthy(1)[0], Signal.BODY_RATE, 29.85, 29.95, lambda rate: rate + 11.0)
    landed = changed(landed, Signal.SPECIFIC_FORCE, 29.85, 29.95, lambda force: 4.0 * force)
    front = front_for([landed], 0.1, ALWAYS)
    assert upsets([airborne(front, landed)]) == ()
    assert far_blocks([airborne(front, one) for one in (landed, *healthy(2))]) == ()


@pytest.mark.parametrize("again", ["file", "content", "part"])
def test_a_flight_that_counts_twice_is_refused(again: str) -> None:
    flights = healthy(2)
    copy = replace(flights[0], name="copy")
    if again != "file":
        moved = [replace(s, t_ns=s.t_ns + 7_000_000_000) for s in copy.telemetry.series]
        copy = replace(copy, sha256="", telemetry=Telemetry(tuple(moved)))
    if again == "part":
        copy = replace(copy, telemetry=between(copy.telemetry, 15.0, None))
    (found,) = repeated([*flights, copy])
    assert (found.number, found.log) == (2, "copy")
    says = {"file": "the same file as flight0", "content": "the same flight as flight0", "part": "are in flight0 as "}
    assert says[again] in found.text
    with pytest.raises(InputError, match=r"copy: .*--robust"):
        learn([*flights, copy], OPTIONS, created=NOW)
    baseline = learn([*flights, copy], ROBUST, created=NOW)
    assert [one.name for one in baseline.provenance.logs] == ["flight0", "flight1"]
    assert baseline.monitors == learn(flights, OPTIONS, created=NOW).monitors


def test_flights_that_overlap_lose_the_overlap_alone() -> None:
    long = healthy(1, 6000)[0]
    early, late = (replace(long, sha256="", name=n, telemetry=between(long.telemetry, *span)) for n, span in
                   (("early", (None, 40.0)), ("late", (30.0, None))))  # fmt: skip
    (found,) = repeated([early, late])
    assert (found.from_s, found.to_s) == pytest.approx((30.0, 40.0), abs=0.1)
    kept = taught([early, late], 0.1, ALWAYS, robust=True).flights
    assert sum(one.judged_s for one in kept) == pytest.approx(57, abs=2)


def test_a_stretch_far_from_the_rest_is_refused_and_named() -> None:
    flights, rough = healthy(4), np.random.default_rng(1).standard_normal
    flights[2] = changed(flights[2], Signal.BODY_RATE, 10.0, 20.0, lambda rate: rate + 0.5 * rough(rate.shape))
    with pytest.raises(InputError, match=r"flight2: gyro noise \d+ .*; cut (1\d|9)\.\d to (19|2\d)\.\d s .* --robust"):
        learn(flights, OPTIONS, created=NOW)
    found = learn(flights, ROBUST, created=NOW).provenance
    assert found.logs[2].judged_s < 20
    assert re.fullmatch(r"flight2, [0-9.]+ to [0-9.]+ s: gyro noise \d+ times [a-z ]+", found.left_out[0])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_flight_whose_gyro_is_turned_round_is_named(axis: int) -> None:
    *flights, last = healthy(3)
    odd = changed(last, Signal.BODY_RATE, 0.0, 1e3, lambda rate: rate * (1.0 - 2.0 * np.eye(3)[axis]))
    with pytest.raises(InputError, match=r"flight2: its (roll|pitch) gyro turns against .*take this log out"):
        learn([*flights, odd], OPTIONS, created=NOW)
    assert len(learn([*flights, odd], ROBUST, created=NOW).provenance.logs) == 2
    with pytest.raises(InputError, match=r"flight2: its .* gyro turns"):
        extend(learn(flights, replace(OPTIONS, monitors=("fsd",)), created=NOW), [odd], created=NOW)


def test_a_set_point_that_slowly_opposes_what_moves_the_vehicle_is_no_gyro_turned_round() -> None:
    swing = np.outer(0.4 * 0.01 * np.arange(3000), [1.0, 0.0, 0.0])  # as on a circle along which the nose turns
    odd = changed(healthy(3)[2], Signal.ATTITUDE_SETPOINT, 0.0, 1e3, lambda angle: angle + 0.3 * np.cos(swing))
    odd = changed(odd, Signal.BODY_RATE, 0.0, 1e3, lambda rate: rate + 0.12 * np.sin(swing))
    assert taught([*healthy(2), odd], 0.1, ALWAYS, robust=False).left_out == ()


def two_vehicles(other: int, rise: float) -> list[Log]:
    """Three flights of one vehicle, and some of another one whose rotor 2 needs more."""
    odd = [Log(f"odd{i}", "", "px4", flying(3000, 300 + i, weak_rotor=2, rise=rise)) for i in range(other)]
    return [*healthy(3), *odd]


def test_two_vehicles_taken_for_one_are_refused_or_learnt_as_a_type() -> None:
    flights = two_vehicles(2, 0.2)
    told = r"odd0: the mean trims .* two groups.* in odd0, odd1 .*--robust; or .*--fleet"
    with pytest.raises(InputError, match=told):
        learn(flights, OPTIONS, created=NOW)
    kept = learn(flights, ROBUST, created=NOW).provenance.logs
    assert [one.name for one in kept] == ["flight0", "flight1", "flight2"]
    fleet = replace(OPTIONS, airframe=replace(FRAME, scope="type"))
    assert len(learn(flights, fleet, created=NOW).provenance.logs) == 5


@pytest.mark.parametrize(("other", "rise"), [(1, 0.2), (2, 0.05)])
def test_one_odd_flight_or_a_small_distance_is_noted(other: int, rise: float) -> None:
    found = learn(two_vehicles(other, rise), replace(OPTIONS, monitors=("rotor_trim", "trim_step")), created=NOW)
    assert len(found.provenance.logs) == 3 + other
    assert "two groups" in found.provenance.notes[0]
    assert "note       odd0" in str(found)


def test_nothing_left_is_said() -> None:
    crash = changed(healthy(1, 600)[0], Signal.BODY_RATE, 2.5, 3.5, lambda rate: rate + TUMBLING)
    with pytest.raises(InputError, match="no healthy flight remains to learn from"):
        learn([crash], ROBUST, created=NOW)


def test_a_threshold_that_its_statistic_cannot_reach_is_not_judged_by() -> None:
    """Sensor noise is cut at 6 times its healthy rms, ln 36 of power: a threshold above it would never be passed."""
    noisy = [replace(log, name=f"n{i}") for i, log in enumerate(two_vehicles(1, 0.8))]
    found = learn(noisy, replace(OPTIONS, monitors=("rotor_trim", "trim_step")), created=NOW)
    (trim,) = [one for one in found.not_judgeable if one.monitor == "rotor_trim"]
    assert "cannot be reached (0.5 at most), blind to losses below " in trim.reason
    assert "rotor_trim" not in {entry.spec.kind for entry in found.monitors}
    assert (found.grade, "odd" in found.weak or "n3" in found.weak) == ("D", True)


X = layout_named("x")
UNTHROTTLED = Telemetry(tuple(s for s in flying(3000, 7).series if s.signal is not Signal.THRUST_SETPOINT))
STRONGER = 0.4 * X.mixing[:, :2] @ X.unmixing[:2, 0]  # a rotor with less thrust and its whole drag: no yaw trim
JERKS = (np.arange(3000) % 500 < 30)[:, None] * STRONGER  # in a tenth of the time it and its opposite outdo the others
SHAKEN = 0.2 * np.random.default_rng(2).standard_normal((3000, 3))


def scaled(signal: Signal, factor: float) -> Telemetry:
    return changed_telemetry(flying(3000, 7), signal, lambda x: factor * x)


def learnt() -> Fingerprint:
    found = fingerprint_of([flying_rows(flying(3000, seed)) for seed in range(100, 105)], X)
    assert found is not None
    return found


def compared(telemetry: Telemetry) -> Likeness:
    return compare(learnt(), flying_rows(telemetry), X)


@pytest.mark.parametrize(
    ("seed", "rotor", "rise"),
    [*((seed, 0, 0.0) for seed in range(7, 12)), (7, 1, 0.03), (7, 2, 0.2), (7, 3, 0.5), (7, 4, 0.2)],
)
def test_new_flights_of_the_same_vehicle_are_alike_and_a_rise_of_one_rotor_is_damage(
    seed: int, rotor: int, rise: float
) -> None:
    assert compared(flying(3000, seed, weak_rotor=rotor, rise=rise)).outcome is Outcome.ALIKE


def yawed(telemetry: Telemetry, share: float) -> Telemetry:
    """Outputs trimmed in yaw by a share of the hover command, which no single rotor does."""
    return changed_telemetry(telemetry, Signal.ACTUATOR, lambda outputs: outputs + 0.5 * share * X.mixing[:, 2])


@pytest.mark.parametrize(
    ("flight", "outcome", "words"),
    [
        (yawed(flying(3000, 7), 0.12), Outcome.FAR, "does not look like E8: yaw trim +0.12"),
        (changed_telemetry(flying(3000, 7), Signal.ACTUATOR, lambda outputs: outputs + STRONGER), Outcome.ALIKE, ""),
        (changed_telemetry(flying(3000, 7), Signal.ACTUATOR, lambda x: x + JERKS[: len(x)]), Outcome.ALIKE, ""),
        (yawed(flying(3000, 7), 0.006), Outcome.NEAR, "may be another vehicle than E8, or have new propellers"),
        # nothing that breaks makes a sensor quieter; better balanced propellers do, by as much as 7
        (scaled(Signal.SPECIFIC_FORCE, 0.15), Outcome.NEAR, "accelerometer noise"),
        (scaled(Signal.SPECIFIC_FORCE, 0.03), Outcome.FAR, "noise z 0.03"),
        (changed_telemetry(flying(3000, 7), Signal.BODY_RATE, lambda rate: rate + SHAKEN), Outcome.ALIKE, ""),
        (scaled(Signal.THRUST_SETPOINT, 0.6), Outcome.FAR, "hover throttle 0.6 times"),
        (scaled(Signal.THRUST_SETPOINT, 1.6), Outcome.NEAR, "hover throttle 1.6 times"),
        (changed_telemetry(UNTHROTTLED, Signal.ACTUATOR, lambda x: 0.6 * x), Outcome.ALIKE, ""),
    ],
)
def test_only_what_no_damage_does_is_another_vehicle(flight: Telemetry, outcome: Outcome, words: str) -> None:
    found = compared(flight)
    assert found.outcome is outcome
    assert words in found.sentence("E8")
    assert "the baseline's" in found.sentence("unnamed") or outcome is Outcome.ALIKE


def sent(change: Change) -> Telemetry:
    """A flight whose outputs are sent in another way."""
    ours = (replace(x, values=change(x.values)) if x.signal is Signal.ACTUATOR else x for x in flying(3000, 7))
    return Telemetry(tuple(ours))


def test_more_motors_are_another_vehicle() -> None:
    found = compared(sent(lambda outputs: np.hstack((outputs, outputs[:, :2]))))
    assert (found.differing, found.outcome) == (("6 motors (learnt 4)",), Outcome.FAR)
    behind = sent(lambda outputs: np.hstack((outputs, 0.0 * outputs, outputs[:, :3])))  # that judging does not take
    assert compared(behind).outcome is Outcome.ALIKE


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 0, 2, 3), (3, 1, 2, 0), (4, 5, 6, 7)])
def test_motors_on_other_outputs_are_another_vehicle_and_no_fault(order: tuple[int, ...]) -> None:
    found = judge(logged(sent(lambda outputs: outputs @ np.eye(8)[list(order)])), whole())
    assert (found.verdict, "outputs wired otherwise" in found.reason) == (Verdict.NOT_JUDGEABLE, True)


@pytest.mark.parametrize(
    ("flight", "judged", "words"),
    [(yawed(flying(3000, 7), 0.12), False, "another vehicle: does not look like made: yaw trim +0.12"),
        (scaled(Signal.SPECIFIC_FORCE, 0.4), True, "; may be another vehicle than made, or have new")],
)  # fmt: skip
def test_another_vehicle_is_not_judged_and_a_near_one_has_a_note(flight: Telemetry, judged: bool, words: str) -> None:
    found = judge(logged(flight), whole())
    assert (found.verdict is not Verdict.NOT_JUDGEABLE) == (found.judged_s > 0) == judged
    assert words in found.reason
    damaged = judge(logged(flying(3000, 7, weak_rotor=3, rise=0.3)), whole())
    assert damaged.verdict is Verdict.FAULT
    assert "another vehicle" not in damaged.reason


def test_the_delay_of_set_points_is_found_in_any_cut_of_the_rows() -> None:
    x, rng = np.zeros((OUTPUTS, 3000)), np.random.default_rng(5)
    x[COMMANDED], x[U : U + 2] = 1.0, rng.standard_normal((2, 3000))
    x[Y : Y + 2] = np.roll(x[U : U + 2], 12, axis=1)
    block, answers = Block(0, 0.01, 10_000_000 * np.arange(3000), x), (Answer(), Answer())
    for answer, rows in zip(answers, (3000, 37), strict=True):
        assert not any(answer.take(block.rows(at, min(at + rows, 3000)), 0.115) for at in range(0, 3000, rows))
    np.testing.assert_array_equal(answers[0].sums, answers[1].sums)
    assert (answers[0].delay_s == pytest.approx(0.12), Answer().take(block, 0.125)) == (True, True)


def test_what_a_trait_varies_by_as_the_vehicle_flies_is_its_spread() -> None:
    """Half of the learnt flight shakes more: a flight that shakes as its calm half did is of the same vehicle."""
    learnt_flight, n = flying(4000, 7), 4000
    factor = np.where(np.arange(n) % 2000 < 1000, 1.0, 4.0)[:, None]
    mixed = changed_telemetry(learnt_flight, Signal.SPECIFIC_FORCE, lambda x: x.mean(0) + (x - x.mean(0)) * factor)
    found, steady = fingerprint_of([flying_rows(mixed)], X), fingerprint_of([flying_rows(learnt_flight)], X)
    assert found is not None
    assert steady is not None
    spreads = [{one.name: one.spread for one in each.figures}["accelerometer noise x"] for each in (steady, found)]
    assert spreads[0] < 0.2 < 0.5 < spreads[1]
    assert compare(found, flying_rows(scaled(Signal.SPECIFIC_FORCE, 0.4)), X).outcome is Outcome.ALIKE


@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_a_noise_below_the_resolution_of_its_signal_is_the_resolution_s(noise: float) -> None:
    """A sensor that hardly moves its last digit: how often it does follows what is flown."""
    digit = 0.0098
    values = digit * np.round(np.random.default_rng(3).normal(0.0, noise, (3000, 3)))
    coarse = changed_telemetry(flying(3000, 7), Signal.SPECIFIC_FORCE, lambda _: values)
    seen = dict(zip((one.name for one in TRAITS), traits(joined(flying_rows(coarse)), X), strict=True))
    expected = [np.log(digit * np.sqrt(0.5)) if np.isfinite(seen["accelerometer noise x"]) else np.nan] * 3
    np.testing.assert_allclose([seen[f"accelerometer noise {axis}"] for axis in "xyz"], expected, atol=0.2)
