"""Rotor layouts: their signs, finding them from a flight, and which output drives which rotor."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import ALWAYS, NOW
from scipy.signal import lfilter

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import contradicts, detect_layout
from mavdiag.airframe.layout import LAYOUTS, RotorLayout, layout_named
from mavdiag.airframe.load import with_layout
from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.errors import UsageError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.rows.block import Block
from mavdiag.telemetry import FloatArray, Log, Signal, Telemetry
from mavdiag.testing import changed, example_rows

#: Where each rotor is, seen from above: (x forward, y right),
#: and how it turns, + counter-clockwise. From each vehicle's own drawing.
PLACES: dict[str, tuple[str, list[tuple[int, int]]]] = {
    "qdrone2": ("-++-", [(-1, 1), (1, 1), (-1, -1), (1, -1)]),
    "crazyflie": ("+-+-", [(1, 1), (-1, 1), (-1, -1), (1, -1)]),
    "x": ("++--", [(1, 1), (-1, -1), (1, -1), (-1, 1)]),
    "plus": ("++--", [(0, 1), (0, -1), (1, 0), (-1, 0)]),
    "hexa-x": ("-+-++-", [(0, 1), (0, -1), (1, -1), (-1, 1), (1, 1), (-1, -1)]),
    "hexa-plus": ("-+-++-", [(1, 0), (-1, 0), (-1, -1), (1, 1), (1, -1), (-1, 1)]),
    "octo-x": ("--++++--", [(1, 1), (-1, -1), (1, 1), (-1, 1), (1, -1), (-1, -1), (1, -1), (-1, 1)]),
    "octo-plus": ("--++++--", [(1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, -1), (0, 1)]),
    "x8": ("+-+-+-+-", [(1, 1), (1, -1), (-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 1), (-1, -1)]),
    "y6": ("+-+--+", [(1, 1), (1, -1), (1, -1), (-1, 0), (1, 1), (-1, 0)]),
    "y6b": ("-+-+-+", [(1, 1), (1, 1), (-1, 0), (-1, 0), (1, -1), (1, -1)]),
    "deca-plus": (
        "+-+-+-+-+-",
        [(1, 0), (1, 1), (1, 1), (-1, 1), (-1, 1), (-1, 0), (-1, -1), (-1, -1), (1, -1), (1, -1)],
    ),
    "deca-x": (
        "+-+-+-+-+-",
        [(1, 1), (1, 1), (0, 1), (-1, 1), (-1, 1), (-1, -1), (-1, -1), (0, -1), (1, -1), (1, -1)],
    ),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_signs_follow_from_where_the_rotors_are(name: str) -> None:
    layout = layout_named(name)
    mixing, n = layout.mixing, layout.rotors
    for signs, sense, (x, y) in zip(mixing, *PLACES[name], strict=True):
        # Thrust is up, -z in FRD: torque = (x, y, 0) x (0, 0, -1) = (-y, x, 0); the body turns against the rotor.
        assert np.sign(np.round(signs, 6)).tolist() == [-y, x, 1.0 if sense == "+" else -1.0]
    np.testing.assert_allclose(mixing.T @ mixing, n * np.eye(3), atol=1e-7)  # independent, and scaled
    np.testing.assert_allclose(mixing.sum(axis=0), 0.0, atol=1e-8)  # trims do not change the thrust
    np.testing.assert_allclose(layout.unmixing @ mixing, np.eye(3), atol=1e-8)
    radius = np.hypot(mixing[:, 0], mixing[:, 1])
    np.testing.assert_allclose(radius, math.sqrt(2), atol=1e-8)  # all of them on one circle
    angles = np.unique(np.round(np.degrees(np.arctan2(-mixing[:, 0], mixing[:, 1])), 6) % 360)
    np.testing.assert_allclose(np.diff(angles), 360 / (n / 2 if layout.coaxial else n), atol=1e-5)
    assert layout.coaxial == (name in ("x8", "y6", "y6b"))
    C = layout.unmixing / np.linalg.norm(layout.unmixing, axis=0)
    assert (C.T @ C - 2 * np.eye(n)).max() < 0.95  # each rotor has a direction of its own


def made_flight(layout: RotorLayout, seed: int, *, driver: str = "torque", yaw: float = 0.2) -> Block:
    """20 s at 100 Hz: a rate loop commands torques, the outputs mix them, the body follows 40 ms later."""
    rng, n = np.random.default_rng(seed), 2000
    wanted = lfilter([0.1], [1, -0.9], rng.normal(0, 0.5, (n, 3)), axis=0) * (1.0, 1.0, yaw)
    torque, rate = np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(4, n):
        rate[i] = rate[i - 1] + torque[i - 4]  # 100 rad/s^2 for full torque
        torque[i] = 0.1 * (wanted[i] - rate[i])
    torque += rng.normal(0, 0.0005, (n, 3))
    rate += rng.normal(0, 0.002, (n, 3))
    outputs = 0.5 * (1.0 + torque @ layout.mixing.T) + rng.normal(0, 0.001, (n, layout.rotors))
    given: FloatArray | None = torque if driver == "torque" else None
    block = example_rows(n, 0.01, rate=rate, actuator=outputs, torque=given).block
    return changed(block, rate_setpoint=wanted) if driver == "rate error" else block


@pytest.mark.parametrize("driver", ["torque", "rate error", "acceleration"])
@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_found_from_a_flight(name: str, driver: str) -> None:
    for seed in range(2):
        found = detect_layout([made_flight(layout_named(name), seed, driver=driver)])
        assert (found.layout, found.likeness[0][0]) == (layout_named(name), name), f"seed {seed}: {found}"
        assert driver in found.reason


@pytest.mark.parametrize("rows", [1, 4, 7, 333])
def test_l6_a_live_link_and_a_log_find_the_same(rows: int) -> None:
    """L6: a live link gives 4 rows a time, a log all of them; the answer is the same, to the last digit."""
    for name in ("x", "plus"):
        flight = made_flight(layout_named(name), 4, driver="rate error")
        pieces = [flight.rows(i, min(i + rows, len(flight))) for i in range(0, len(flight), rows)]
        assert detect_layout(pieces) == detect_layout([flight])
        assert detect_layout(pieces).layout is layout_named(name)
        with pytest.MonkeyPatch.context() as patch:  # and some thousand rows are in memory at a time
            patch.setattr("mavdiag.airframe.detect.PIECE_ROWS", 500)
            assert detect_layout(pieces).likeness[0][1] == pytest.approx(detect_layout([flight]).likeness[0][1])


def test_l6_outputs_that_never_move_come_late_or_are_missing_are_left_out() -> None:
    """L6: PX4 logs carry 8 or 16 outputs, whatever the vehicle has."""
    flight = made_flight(layout_named("x"), 5)
    idle = [np.hstack([flight.actuator, np.full((len(flight), 4), level)]) for level in (0.0, math.nan, 0.45)]
    for wide in idle:
        assert detect_layout([changed(flight, actuator=wide)]).layout is layout_named("x")
    before = changed(flight.rows(0, 300), actuator=np.empty((300, 0)))
    assert detect_layout([before, flight.rows(300, len(flight))]).layout is layout_named("x")
    outputs, torque = flight.actuator.copy(), flight.torque.copy()
    outputs[200:400], torque[900:1100] = math.nan, math.nan
    assert detect_layout([changed(flight, actuator=outputs, torque=torque)]).layout is layout_named("x")


def test_l6_a_yawing_flight_does_not_hide_roll_and_pitch() -> None:
    """L6: the drivers are correlated in turns; each alone would take the effect of the others."""
    rng = np.random.default_rng(7)
    for name in ("x", "plus", "hexa-x"):
        layout = layout_named(name)
        torque = rng.normal(0, 0.02, (3000, 3)) @ np.array([[1, 0.6, 0.5], [0, 1, 0.6], [0, 0, 1]])
        outputs = 0.5 * (1 + torque @ layout.mixing.T)
        found = detect_layout([example_rows(3000, 0.01, actuator=outputs, torque=torque).block])
        assert found.layout is layout
        assert found.likeness[0][1] == pytest.approx(1.0, abs=1e-6)


def test_what_stays_unclear_is_not_named() -> None:
    rng = np.random.default_rng(3)
    x = layout_named("x")
    quiet = example_rows(2000, 0.01, actuator=np.full((2000, 4), 0.5)).block
    noise = rng.normal(0.5, 0.05, (2000, 4))
    random = example_rows(2000, 0.01, rate=rng.normal(0, 0.1, (2000, 3)), actuator=noise).block
    reversed_signs = made_flight(RotorLayout("reversed", tuple((-r, -p, -y) for r, p, y in x.signs)), 1)
    other_spins = made_flight(RotorLayout("h", tuple((r, p, -y) for r, p, y in x.signs)), 1, yaw=1.0)
    between = made_flight(RotorLayout("turned", tuple(_turned(s, 22.5) for s in x.signs)), 1)
    five = changed(reversed_signs, actuator=reversed_signs.actuator[:, [0, 1, 2, 3, 0]])
    shifted = changed(other_spins, actuator=np.hstack([np.zeros((2000, 4)), other_spins.actuator]))
    reasons = {
        "carry no rotor outputs": (quiet, example_rows(2000).block),
        "hardly follow": (random,),
        "no known layout fits clearly": (reversed_signs, other_spins, between, shifted),
        "5 outputs move (1, 2, 3, 4, 5) and no known layout": (five,),
        "too short": (made_flight(x, 1).rows(0, 100),),
    }
    for reason, blocks in reasons.items():
        for block in blocks:
            found = detect_layout([block])
            assert found.layout is None, reason
            assert reason in found.reason
    assert detect_layout([]).layout is None


def _turned(signs: tuple[float, float, float], degrees: float) -> tuple[float, float, float]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return c * signs[0] - s * signs[1], s * signs[0] + c * signs[1], signs[2]


UNKNOWN = Airframe(gate=ALWAYS)
TRIM = ("rotor_trim", "innovation")
COPTER_X = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}
SERVOS_5 = {f"SERVO{n}_FUNCTION": 28.0 + n for n in (5, 6, 7, 8)}


def servo(n: int, seed: int) -> FloatArray:
    """(n, 1) of a camera servo that goes its own way."""
    steps = np.random.default_rng(seed).normal(0, 0.01, (n, 1))
    return np.clip(0.5 + np.cumsum(steps, axis=0), 0, 1)


def wide(block: Block, *columns: FloatArray | int) -> Block:
    """The block with these outputs: a motor by its number from 1, or a column."""
    parts = [block.actuator[:, [one - 1]] if isinstance(one, int) else one for one in columns]
    return changed(block, actuator=np.hstack(parts))


def unyawed(layout: RotorLayout, seed: int) -> Block:
    """20 s in which the outputs never answer a yaw command."""
    rng = np.random.default_rng(seed)
    torque = rng.normal(0, 0.02, (2000, 3))
    outputs = 0.5 * (1 + torque * (1, 1, 0) @ layout.mixing.T) + rng.normal(0, 0.001, (2000, layout.rotors))
    return example_rows(2000, actuator=outputs, torque=torque).block


@pytest.mark.parametrize("name", ["x", "plus", "hexa-x", "octo-x"])
@pytest.mark.parametrize("driver", ["torque", "rate error", "acceleration"])
def test_motors_are_found_behind_idle_outputs_and_between_servos(name: str, driver: str) -> None:
    layout = layout_named(name)
    for seed in range(3):
        flight = made_flight(layout, 20 + seed, driver=driver)
        n, first = len(flight), layout.rotors // 2
        idle, low = np.full((n, 1), 0.45), 0.02 + 0.01 * servo(n, seed)
        motors = list(range(1, layout.rotors + 1))
        behind = detect_layout([wide(flight, idle, np.zeros((n, 1)), low, idle, *motors)])
        assert (behind.layout, behind.outputs) == (layout, tuple(range(5, 5 + layout.rotors)))
        mixed = wide(flight, *motors[:first], servo(n, seed), *motors[first:], servo(n, seed + 50))
        between = detect_layout([mixed])
        assert between.layout is layout
        assert between.outputs == tuple(one if one <= first else one + 1 for one in motors)


@pytest.mark.parametrize("name", ["x", "plus", "hexa-x", "octo-plus"])
def test_another_order_is_found_where_yaw_is_seen(name: str) -> None:
    layout, rng = layout_named(name), np.random.default_rng(4)
    for seed in range(3):
        order = [int(one) for one in np.roll(rng.permutation(layout.rotors), 1)]  # the motor on each output
        flight = made_flight(layout, 40 + seed, yaw=1.0)
        found = detect_layout([wide(flight, *(one + 1 for one in order))])
        assert found.layout is not None
        said = dict(zip(found.outputs, found.layout.signs, strict=True))
        for output, motor in enumerate(order, start=1):
            np.testing.assert_allclose(said[output], layout.signs[motor], atol=1e-6)
    still = detect_layout([wide(unyawed(layout, 40), *(one + 1 for one in order))])
    assert still.layout is None


@pytest.mark.parametrize("name", ["plus", "hexa-x", "octo-x", "octo-plus"])
def test_what_the_flights_hardly_show_is_never_another_layout(name: str) -> None:
    """Under noise an emulated octo was named a quad: four of its motors hardly followed, and were left out."""
    layout, found = layout_named(name), []
    for noise in (0.005, 0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2):
        for seed in range(4):
            rng = np.random.default_rng(seed)
            torque = rng.normal(0, 0.02, (2000, 3)) * (1.0, 1.0, 0.1)
            outputs = 0.5 * (1 + torque @ layout.mixing.T + rng.normal(0, noise, (2000, layout.rotors)))
            found.append(detect_layout([example_rows(2000, actuator=outputs, torque=torque).block]).layout)
    assert set(found) == {layout, None}


def test_what_is_told_is_held_against_the_flights() -> None:
    x, flight = layout_named("x"), made_flight(layout_named("x"), 3, yaw=1.0)
    fits = RotorLayout("own", tuple((1.05 * r if i % 2 else 0.9474 * r, p, y) for i, (r, p, y) in enumerate(x.signs)))
    reversed_x = RotorLayout("reversed", tuple((-r, -p, -y) for r, p, y in x.signs))
    says = {
        x: "",
        fits: "",
        layout_named("plus"): "look like x, not plus (plus 0.",
        reversed_x: "look like x, not reversed (reversed -1",
        layout_named("hexa-x"): "look like x, not hexa-x",
    }
    for layout, words in says.items():
        known = (layout, *(one for one in LAYOUTS.values() if one.name != layout.name))
        found = contradicts(detect_layout([flight], known), layout)
        assert words in found
        assert bool(words) == bool(found)


def shifted(telemetry: Telemetry, *, seed: int = 0) -> Telemetry:
    """The motors on outputs 5 to 8, idle ones before them and a camera's servo behind."""
    parts = []
    for one in telemetry:
        if one.signal is Signal.ACTUATOR:
            n = len(one)
            idle = np.tile([0.0, 0.45, 0.0, 0.5], (n, 1))
            parts.append(replace(one, values=np.hstack((idle, one.values, servo(n, seed)))))
        else:
            parts.append(one)
    return Telemetry(tuple(parts))


def flights(count: int, parameters: dict[str, float] | None = None) -> list[Log]:
    made = [(i, shifted(flying(3000, 100 + i), seed=i)) for i in range(count)]
    return [Log(f"f{i}", f"{i:064x}", "px4", telemetry, parameters=parameters or {}) for i, telemetry in made]


def taught(logs: list[Log], airframe: Airframe = UNKNOWN) -> Baseline:
    return learn(logs, LearnOptions(airframe=airframe, monitors=TRIM), created=NOW)


@pytest.mark.parametrize(
    ("parameters", "basis"),
    [
        ({}, "found from outputs and torque command"),
        (COPTER_X, "the vehicle's parameters FRAME_CLASS 1, FRAME_TYPE 1"),
        ({**COPTER_X, **SERVOS_5}, "the vehicle's parameters FRAME_CLASS 1, FRAME_TYPE 1"),
        ({**SERVOS_5, "FRAME_CLASS": 1.0}, "found from outputs and torque command"),
    ],
)
def test_a_baseline_keeps_the_outputs_and_names_the_weak_rotor(parameters: dict[str, float], basis: str) -> None:
    baseline = parse(dump(taught(flights(3, parameters=parameters))))
    assert baseline.airframe.layout is not None
    assert (baseline.airframe.layout.name, baseline.airframe.outputs) == ("x", (5, 6, 7, 8))
    assert baseline.airframe.layout_basis.startswith(basis)
    assert f"rotor layout x, its rotors on outputs 5, 6, 7, 8 ({basis}" in str(baseline)
    weak = Log("weak", "", "px4", shifted(flying(3000, 7, weak_rotor=3, rise=0.3)))
    verdict = judge(weak, baseline)
    assert verdict.verdict is Verdict.FAULT
    assert "rotor 3" in verdict.reason
    healthy = judge(Log("healthy", "", "px4", shifted(flying(3000, 8))), baseline)
    assert (healthy.verdict, healthy.notes) == (Verdict.HEALTHY, ())
    by_motor = Log("weak", "", "px4", flying(3000, 7, weak_rotor=3, rise=0.3), motor_order=True)
    assert "rotor 3" in judge(by_motor, baseline).reason


def test_logs_by_motor_need_no_outputs() -> None:
    """A DataFlash log's columns are the motors; SERVOn_FUNCTION must not be applied once more."""
    logs = [
        Log(f"f{i}", "", "px4", flying(3000, i), parameters={**COPTER_X, **SERVOS_5}, motor_order=True) for i in (1, 2)
    ]
    frame = taught(logs).airframe
    assert frame.layout is layout_named("x")
    assert (frame.outputs, frame.layout_warning) == (None, "")


def test_told_wins_over_parameters_and_parameters_over_flights_and_a_contradiction_is_loud() -> None:
    plus = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 0.0}
    told = taught(flights(2, parameters=plus), with_layout(UNKNOWN, "x"))
    assert (told.airframe.layout, told.airframe.layout_basis) == (layout_named("x"), "told")
    assert (told.airframe.outputs, told.layout_doubt) == ((5, 6, 7, 8), "")
    by_parameters = taught(flights(2, parameters=plus))
    assert by_parameters.airframe.layout is layout_named("plus")
    assert "WARNING: the flights look like x, not plus" in by_parameters.layout_doubt
    assert by_parameters.layout_doubt in str(by_parameters)
    assert by_parameters.layout_doubt in judge(flights(1)[0], by_parameters).notes
    other = judge(flights(1, parameters=plus)[0], told)
    assert "the log is of another rotor layout: plus by the vehicle's parameters" in other.reason


def silent(count: int) -> list[Log]:
    """Flights without outputs."""
    return [
        Log(f"f{i}", "", "px4", Telemetry(tuple(s for s in flying(3000, i) if s.signal is not Signal.ACTUATOR)))
        for i in range(count)
    ]


def test_an_unknown_layout_is_loud_in_the_baseline_and_in_every_verdict() -> None:
    baseline = taught(silent(2))
    line = (
        "rotor layout unknown: the data carry no rotor outputs that move; rotor_signature, rotor_trim, rotor_speed, "
        "trim_step do not judge, and no rotor is named; name it with --layout or --airframe"
    )
    assert line in str(baseline).splitlines()
    verdict = judge(silent(1)[0], baseline)
    assert verdict.notes == (line,)
    assert line in verdict.reason
    found = json.loads(json.dumps(verdict_json(verdict)))
    assert found["notes"] == [line]
    unconcerned = learn(silent(2), LearnOptions(airframe=UNKNOWN, monitors=("innovation",)), created=NOW)
    assert judge(silent(1)[0], unconcerned).notes == ()


def test_an_airframe_has_the_layout_of_its_file_or_the_one_that_is_told() -> None:
    with pytest.raises(UsageError, match="airframe a has the layout x, not plus: give one of them"):
        with_layout(Airframe(name="a", layout=layout_named("x")), "plus")
    with pytest.raises(UsageError, match="no layout 'y'"):
        with_layout(UNKNOWN, "y")


@pytest.mark.parametrize(("name", "weak", "arm"), [("x8", 6, "1/6"), ("y6", 4, "4/6"), ("y6b", 1, "1/2")])
def test_the_arm_is_named_where_rotors_share_one(name: str, weak: int, arm: str) -> None:
    """X8 and Y6: both rotors of an arm move roll and pitch alike."""
    airframe = with_layout(UNKNOWN, name)
    taught = [Log(f"{seed}", f"{seed:064x}", "px4", flying(3000, seed, layout=name)) for seed in (1, 2)]
    base = learn(taught, LearnOptions(airframe=airframe, monitors=("rotor_trim", "trim_step")), created=NOW)
    found = judge(Log("weak", "", "px4", flying(3000, 3, layout=name, weak_rotor=weak, rise=0.4)), base)
    assert found.verdict is Verdict.FAULT
    assert f"rotor {arm}" in found.reason
    assert found.rotor == int(arm[0])
    assert json.loads(json.dumps(found.rotor)) == int(arm[0])
