"""Rotor layouts: their signs, finding them from a flight, and which output drives which rotor."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flying_telemetry import flying, without
from hypothesis import given
from hypothesis import strategies as st
from made_baselines import ALWAYS, NOW
from made_rows import changed, example_rows
from made_vehicle import MadeVehicle
from scipy.signal import lfilter
from shared_data import written

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import contradicts, detect_layout
from mavdiag.airframe.layout import LAYOUTS, Place, RotorLayout, layout_at, layout_named
from mavdiag.airframe.load import BUILTIN, airframe_from, airframe_named, load_airframe, with_layout
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.errors import InputError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, extend, learn
from mavdiag.link.codec import Encoder
from mavdiag.link.datagrams import as_columns
from mavdiag.link.messages import Autopilot, MessageId
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.rows.block import Block
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import FloatArray, Log, Signal, Telemetry
from mavdiag.units import RPM

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
    "deca-plus": ("+-" * 5, [(1, 0), (1, 1), (1, 1), (-1, 1), (-1, 1), (-1, 0), (-1, -1), (-1, -1), (1, -1), (1, -1)]),
    "deca-x": ("+-+-+-+-+-", [(1, 1), (1, 1), (0, 1), (-1, 1), (-1, 1), (-1, -1), (-1, -1), (0, -1), (1, -1), (1, -1)]),
}
UNKNOWN = Airframe(gate=ALWAYS)
TRIM = ("rotor_trim", "innovation")
COPTER_X = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}
SERVOS_5 = {f"SERVO{n}_FUNCTION": 28.0 + n for n in (5, 6, 7, 8)}
ROOT = Path(__file__).resolve().parents[2]
QUAD_X = ((0.15, 0.2, 0.05), (-0.15, -0.2, 0.05), (0.15, -0.2, -0.05), (-0.15, 0.2, -0.05))  # x, y, KM: PX4's quad x
NUMBERS = st.one_of(st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -4.0, 0.5, 3e6, 1e9]), st.floats())
NAMES = ("FRAME_CLASS", "FRAME_TYPE", "FRAME", "CA_AIRFRAME", "SERVO1_FUNCTION", "SERVO2_FUNCTION", "PWM_MAIN_FUNC1")


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


@pytest.mark.parametrize(("rows", "per_row"), [(3, 1), (333, 1), (47, 10)])
def test_l6_a_live_link_and_a_log_find_the_same(rows: int, per_row: int) -> None:
    """L6: a live link gives 4 rows a time, a log all of them; the answer is the same, to the last digit."""
    for name in ("x", "plus"):
        slow = made_flight(layout_named(name), 4, driver="rate error")
        t_ns, x = np.arange(per_row * len(slow)) * 10_000_000 // per_row, np.repeat(slow.x, per_row, axis=1)
        flight = Block(slow.segment, slow.dt_s / per_row, t_ns, x, slow.outputs)
        pieces = [flight.rows(i, min(i + rows, len(flight))) for i in range(0, len(flight), rows)]
        assert detect_layout(pieces) == detect_layout([flight])
        assert detect_layout(pieces).layout is layout_named(name)
        with pytest.MonkeyPatch.context() as patch:  # and some thousand rows are in memory at a time
            patch.setattr("mavdiag.airframe.detect.PIECE_ROWS", 500)
            assert detect_layout(pieces).likeness[0][1] == pytest.approx(detect_layout([flight]).likeness[0][1])


def test_what_stays_unclear_is_not_named() -> None:
    rng, x = np.random.default_rng(3), layout_named("x")
    quiet = example_rows(2000, 0.01, actuator=np.full((2000, 4), 0.5)).block
    noise = rng.normal(0.5, 0.05, (2000, 4))
    random = example_rows(2000, 0.01, rate=rng.normal(0, 0.1, (2000, 3)), actuator=noise).block
    reversed_signs = made_flight(RotorLayout("reversed", tuple((-r, -p, -y) for r, p, y in x.signs)), 1)
    other_spins = made_flight(RotorLayout("h", tuple((r, p, -y) for r, p, y in x.signs)), 1, yaw=1.0)
    c, s = math.cos(math.radians(22.5)), math.sin(math.radians(22.5))
    between = made_flight(RotorLayout("turned", tuple((c * r - s * p, s * r + c * p, y) for r, p, y in x.signs)), 1)
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


def servo(n: int, seed: int) -> FloatArray:
    """(n, 1) of a camera servo that goes its own way."""
    return np.clip(0.5 + np.cumsum(np.random.default_rng(seed).normal(0, 0.01, (n, 1)), axis=0), 0, 1)


def wide(block: Block, *columns: FloatArray | int) -> Block:
    """The block with these outputs: a motor by its number from 1, or a column."""
    parts = [block.actuator[:, [one - 1]] if isinstance(one, int) else one for one in columns]
    return changed(block, actuator=np.hstack(parts))


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
        between = detect_layout([wide(flight, *motors[:first], servo(n, seed), *motors[first:], servo(n, seed + 50))])
        assert between.layout is layout
        assert between.outputs == tuple(one if one <= first else one + 1 for one in motors)


@pytest.mark.parametrize("name", ["x", "plus", "hexa-x", "octo-plus"])
def test_another_order_is_found_where_yaw_is_seen(name: str) -> None:
    layout, rng = layout_named(name), np.random.default_rng(4)
    for seed in range(3):
        order = [int(one) for one in np.roll(rng.permutation(layout.rotors), 1)]  # the motor on each output
        found = detect_layout([wide(made_flight(layout, 40 + seed, yaw=1.0), *(one + 1 for one in order))])
        assert found.layout is not None
        said = dict(zip(found.outputs, found.layout.signs, strict=True))
        for output, motor in enumerate(order, start=1):
            np.testing.assert_allclose(said[output], layout.signs[motor], atol=1e-6)
    torque, n = np.random.default_rng(40).normal(0, 0.02, (2000, 3)), layout.rotors
    outputs = 0.5 * (1 + torque * (1, 1, 0) @ layout.mixing.T) + rng.normal(0, 0.001, (2000, n))
    still = example_rows(2000, actuator=outputs, torque=torque).block  # the outputs never answer a yaw command
    assert detect_layout([wide(still, *(one + 1 for one in order))]).layout is None


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
    motors = telemetry.need(Signal.ACTUATOR)
    idle = np.tile([0.0, 0.45, 0.0, 0.5], (len(motors), 1))
    more = replace(motors, values=np.hstack((idle, motors.values, servo(len(motors), seed))))
    return Telemetry(tuple(more if one is motors else one for one in telemetry))


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
    verdict = judge(Log("weak", "", "px4", shifted(flying(3000, 7, weak_rotor=3, rise=0.3))), baseline)
    assert verdict.verdict is Verdict.FAULT
    assert "rotor 3" in verdict.reason
    healthy = judge(Log("healthy", "", "px4", shifted(flying(3000, 8))), baseline)
    assert (healthy.verdict, healthy.notes) == (Verdict.HEALTHY, ())
    by_motor = Log("weak", "", "px4", flying(3000, 7, weak_rotor=3, rise=0.3), motor_order=True)
    assert "rotor 3" in judge(by_motor, baseline).reason
    more = Log("more", "", "px4", flying(3000, 9), motor_order=True)
    (old, *_), (new, *_) = baseline.monitors, extend(baseline, [more], created=NOW).monitors
    np.testing.assert_allclose(new.spec.mean, old.spec.mean, atol=0.003)


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


def test_an_unknown_layout_is_loud_in_the_baseline_and_in_every_verdict() -> None:
    flown = [without(flying(3000, seed), (0.0, 1e9), signals=(Signal.ACTUATOR,)) for seed in (0, 1)]
    silent = [Log(f"f{i}", "", "px4", telemetry) for i, telemetry in enumerate(flown)]
    baseline = taught(silent)
    line = (
        "rotor layout unknown: the data carry no rotor outputs that move; rotor_signature, rotor_trim, rotor_speed, "
        "trim_step do not judge, and no rotor is named; name it with --layout or --airframe"
    )
    assert line in str(baseline).splitlines()
    verdict = judge(silent[0], baseline)
    assert verdict.notes == (line,)
    assert line in verdict.reason
    assert verdict_json(verdict)["notes"] == [line]
    unconcerned = learn(silent, LearnOptions(airframe=UNKNOWN, monitors=("innovation",)), created=NOW)
    assert judge(silent[0], unconcerned).notes == ()


@pytest.mark.parametrize(("name", "weak", "arm"), [("x8", 6, "1/6"), ("y6", 4, "4/6"), ("y6b", 1, "1/2")])
def test_the_arm_is_named_where_rotors_share_one(name: str, weak: int, arm: str) -> None:
    """X8 and Y6, found by how their outputs move: both rotors of an arm move roll and pitch alike."""
    taught = [Log(f"{seed}", f"{seed:064x}", "px4", flying(3000, seed, layout=name)) for seed in (1, 2)]
    base = learn(taught, LearnOptions(airframe=UNKNOWN, monitors=("rotor_trim", "trim_step")), created=NOW)
    found = judge(Log("weak", "", "px4", flying(3000, 3, layout=name, weak_rotor=weak, rise=0.4)), base)
    assert found.verdict is Verdict.FAULT
    assert f"rotor {arm}" in found.reason
    assert found.rotor == int(arm[0])


@pytest.mark.parametrize("name", BUILTIN)
def test_shipped_airframes_have_a_layout(name: str) -> None:
    assert airframe_from(name) == airframe_named(name)
    assert airframe_named(name).layout == layout_named(name.removesuffix("-recorded"))
    assert sorted(BUILTIN) == sorted(p.stem for p in (ROOT / "mavdiag" / "airframe").glob("*.toml"))


def test_every_key_arrives_and_what_a_file_leaves_out_is_not_known(tmp_path: Path) -> None:
    """B18: nothing of a QDrone 2 is taken for another vehicle."""
    assert load_airframe(written(tmp_path / "vehicle.toml", 'name = "other"')) == Airframe(name="other")
    path = written(
        tmp_path / "vehicle.toml",
        'name = "survey"\nscope = "type"\nlayout = "octo-x"\nmass_kg = 9\nhover_rpm = 3000\nimu_corner_hz = 20.5\n'
        'classifier = "ours"\n[gate]\nmin_height_m = 1\nmin_thrust = 0.2\nneed_armed = false\ntrim_start_s = 2\n'
        "trim_end_s = 1\n",
    )
    vehicle = Airframe(name="survey", scope="type", layout=layout_named("octo-x"), mass_kg=9.0, hover_rad_s=3000 * RPM)
    gate = GateSpec(1.0, 0.2, False, 2.0, 1.0)
    assert airframe_from(str(path)) == replace(vehicle, imu_corner_hz=20.5, gate=gate, classifier="ours")


PLACE = '[[rotors]]\nx_m = 1\ny_m = 1\nspin = "cw"\n'
REFUSED = [
    ("", "name: Field required"),
    ('name = "a"\nmass_kg = "1"', "mass_kg: Input should be a valid number"),
    ('name = "a"\nhover_rpm = nan', "hover_rpm: Input should be a finite number"),
    ('name = "a"\nhover_rpm = 1e7', "hover_rpm: Input should be less than or equal to 1000000"),
    (f'name = "a"\n{PLACE}[[rotors]]\nx_m=1\ny_m=1e3', "rotors.2.y_m: Input should be less than or equal to 100"),
    ('name = "a"\nlayout = "tri"', "layout: no layout 'tri': use one of qdrone2, "),
    ('name = "a"\n[gate]\nmin_hight_m = 1', "gate.min_hight_m: no such key"),
    ('name = "a"\n[gate]\ntrim_start_s = 1e12', "gate.trim_start_s: Input should be less than or equal to 600"),
    (f'name = "a"\nlayout = "x"\n{PLACE}', "rotors: give either rotors or the name of a layout"),
    (f'name = "x"\n{PLACE}', "rotors: x is a known layout: give these rotors another name"),
    (f'name = "a"\n{PLACE}', "rotors: layout a: its rotors cannot command roll, pitch and yaw independently"),
    (f'name = "a"\n{PLACE}[[rotors]]\nroll=1\npitch=1\nyaw=1', "rotors: give all rotors as places or all as effects"),
    (f'name = "a"\n{PLACE}[[rotors]]\nx_m=1\ny_m=1\nspin="left"', "rotors.2.spin: Input should be 'cw' or 'ccw'"),
    ('name = "a"\n[[rotors]]\nroll=1\npitch=1\nx_m=1', "rotors.1.yaw: Field required"),
    ('name = "a"\nlayout = "x"\noutputs = [1, 2, 3]', "outputs: airframe: 3 outputs for 4 rotors"),
    ('name = "a"\nlayout = "x"\noutputs = [1, 2, 3, 3]', "outputs: airframe: outputs count from 1"),
    ('name = "a"\nlayout = "x"\noutputs = [0, 1, 2, 3]', "outputs.1: Input should be greater"),
    ("name = ", "not TOML: "),
]


@pytest.mark.parametrize(("text", "reason"), REFUSED)
def test_what_is_wrong_is_named_with_its_file(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path / "vehicle.toml", text)
    with pytest.raises(InputError) as caught:
        airframe_from(str(path))
    assert str(caught.value).startswith(f"{path}: {reason}")
    assert "\n" not in str(caught.value)


def servos(*functions: int, first: int = 1) -> dict[str, float]:
    return {f"SERVO{first + i}_FUNCTION": float(one) for i, one in enumerate(functions)}


def rotors(*rows: tuple[float, float, float]) -> dict[str, float]:
    named = {
        f"CA_ROTOR{n}_{part}": v for n, row in enumerate(rows) for part, v in zip(("PX", "PY", "KM"), row, strict=True)
    }
    return {"CA_ROTOR_COUNT": float(len(rows)), "CA_AIRFRAME": 0.0, **named}


def outputs(group: str, *motors: int, first: int = 1) -> dict[str, float]:
    return {f"{group}_FUNC{first + i}": float(100 + motor) for i, motor in enumerate(motors)}


# From ArduPilot's tables: the place of motor 1, 2, ... by angle from the nose to the right; +: counter-clockwise.
COPTER: dict[tuple[int, int], tuple[str, tuple[float, ...]]] = {
    (1, 0): ("++--", (90, -90, 0, 180)),
    (1, 1): ("++--", (45, -135, -45, 135)),
    (1, 12): ("-++-", (135, 45, -135, -45)),
    (2, 1): ("-+-++-", (90, -90, -30, 150, 30, -150)),
    (4, 0): ("+-+-+-+-", (0, -90, 180, 90, -90, 0, 90, 180)),
    (4, 12): ("-++-+--+", (135, 45, -135, -45, 135, 45, -135, -45)),
    (5, 1): ("+-+--+", (60, -60, -60, 180, 60, 180)),
    (12, 1): ("+--++--++--+", (30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30)),
    (14, 0): ("+-+-+-+-+-", (0, 36, 72, 108, 144, 180, -144, -108, -72, -36)),
}


@pytest.mark.parametrize("frame", COPTER)
def test_frame_class_and_type_are_the_tables_of_ardupilot(frame: tuple[int, int]) -> None:
    found = layout_from_parameters({"FRAME_CLASS": float(frame[0]), "FRAME_TYPE": float(frame[1])})
    assert found.layout is not None
    senses, angles_deg = COPTER[frame]
    places = [
        Place(math.cos(math.radians(deg)), math.sin(math.radians(deg)), "ccw" if sense == "+" else "cw")
        for sense, deg in zip(senses, angles_deg, strict=True)
    ]
    np.testing.assert_allclose(found.layout.mixing, layout_at("drawn", places).mixing, atol=1e-8)
    assert found.reason == f"the vehicle's parameters FRAME_CLASS {frame[0]}, FRAME_TYPE {frame[1]}"
    assert found.layout.coaxial == (len(set(angles_deg)) < len(angles_deg))
    assert found.layout.name not in LAYOUTS or found.layout is LAYOUTS[found.layout.name]


@pytest.mark.parametrize(
    ("frame", "kind", "name"),
    [(0, 2, "plus"), (1, 2, "x"), (2, 2, "v"), (3, 2, "h"), (1, 13, None), (1, None, None), (4, 2, None)],
)
def test_the_frame_of_older_copters_is_that_of_a_quad(frame: int, kind: int | None, name: str | None) -> None:
    found = layout_from_parameters({"FRAME": float(frame)}, kind)
    assert (found.layout.name if found.layout is not None else None) == name
    assert found.outputs is None


def test_servo_functions_say_which_output_drives_which_motor() -> None:
    found = layout_from_parameters({**COPTER_X, **servos(0, 0, 36, 33, 34, 0, 35, 10)})
    assert (found.layout, found.outputs) == (layout_named("x"), (4, 5, 7, 3))
    assert layout_from_parameters(COPTER_X).outputs is None
    only_outputs = layout_from_parameters(servos(33, 34, 35, 36, first=5))
    assert (only_outputs.layout, only_outputs.outputs) == (None, (5, 6, 7, 8))
    old = {f"RC{n}_FUNCTION": float(one) for n, one in enumerate((33, 34, 35, 36), start=5)}
    assert layout_from_parameters(old).outputs == (5, 6, 7, 8)
    assert layout_from_parameters({**servos(34, 33, 36, 35), "RC9_FUNCTION": 33.0}).outputs == (2, 1, 4, 3)


@given(
    st.dictionaries(st.sampled_from([*NAMES, "CA_ROTOR_COUNT", *rotors(*QUAD_X), "SOMETHING"]), NUMBERS), st.booleans()
)
def test_no_value_of_a_parameter_is_an_exception_or_a_long_list(wrong: dict[str, float], px4: bool) -> None:
    sound = {**rotors(*QUAD_X), **outputs("PWM_MAIN", 1, 2, 3, 4)} if px4 else {**COPTER_X, **servos(33, 34, 35, 36)}
    found = layout_from_parameters({**sound, **wrong})
    assert found.layout is None or found.layout.rotors <= 12
    assert found.layout is not None or found.outputs is not None or found.reason
    odd = {"SYS_AUTOSTART": math.nan, "MPC_XY_CRUISE": math.inf}
    assert layout_from_parameters({**sound, **odd}) == layout_from_parameters(sound)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({}, ""),
        ({"FRAME": 1.0, "THR_MIN": 130.0}, ""),
        ({"FRAME_CLASS": 1.0}, "FRAME_TYPE is not among the parameters"),
        ({"FRAME_CLASS": 1.0, "FRAME_TYPE": 4.0}, "the geometry of FRAME_CLASS 1, FRAME_TYPE 4 is not known"),
        ({**COPTER_X, **servos(33, 34, 35)}, "SERVOn_FUNCTION has the motors 1, 2, 3, x has 4"),
        ({**COPTER_X, **servos(33, 34, 35, 36, 33)}, "motors 1, 1, 2, 3, 4, x has 4"),
        ({**COPTER_X, **rotors(*QUAD_X)}, "of two autopilots"),
        ({**rotors(*QUAD_X), "CA_AIRFRAME": 2.0}, "CA_AIRFRAME 2 is no multirotor"),
        ({**rotors(*QUAD_X), "CA_ROTOR_COUNT": 5.0}, "CA_ROTOR4_PX is not among the parameters"),
        ({**rotors(*QUAD_X), "CA_ROTOR2_AZ": 0.0, "CA_ROTOR2_AX": 1.0}, "rotor 3 does not push straight up"),
        ({**rotors(*QUAD_X), "CA_ROTOR3_KM": 0.0}, "CA_ROTOR3_KM is 0"),
        ({**rotors(*QUAD_X), "CA_ROTOR0_CT": 6.5, "CA_ROTOR1_CT": 9.0}, "differ in thrust"),
        (rotors((0.1, 0, 0.05), (-0.1, 0, 0.05), (0.2, 0, -0.05)), "make no layout"),
        *(
            ({**rotors(*QUAD_X), "CA_ROTOR_COUNT": n}, f"CA_ROTOR_COUNT {n:g} is no number of rotors (1 to 12)")
            for n in (1e9, -4.0, 0.0, 13.0, 4.5, math.nan)
        ),
    ],
)
def test_what_is_unknown_or_contradicts_itself_has_a_reason(parameters: dict[str, float], reason: str) -> None:
    found = layout_from_parameters(parameters)
    assert (found.layout, found.outputs) == (None, None)
    assert reason in found.reason
    assert bool(reason) == bool(found.reason)


def test_px4_rotors_are_places_and_senses_and_its_groups_of_outputs_must_agree() -> None:
    """A positive KM is counter-clockwise, and turns the nose to the right."""
    square = tuple((x, y / 0.2 * 0.15, km) for x, y, km in QUAD_X)
    assert layout_from_parameters(rotors(*square)).layout is layout_named("x")
    found = layout_from_parameters({**rotors(*QUAD_X), **outputs("PWM_MAIN", 3, 1, 4, 2, first=2)})
    assert found.outputs == (3, 5, 2, 4)
    assert found.layout is not None
    assert np.sign(found.layout.mixing).tolist() == np.sign(layout_named("x").mixing).tolist()
    hexa = [(math.cos(math.radians(deg)), math.sin(math.radians(deg))) for deg in (90, -90, -30, 150, 30, -150)]
    moments = (-0.05, 0.05, -0.05, 0.05, 0.05, -0.05)
    seen = layout_from_parameters(rotors(*((x, y, km) for (x, y), km in zip(hexa, moments, strict=True))))
    assert seen.layout is layout_named("hexa-x")
    both = {**rotors(*QUAD_X), **outputs("PWM_MAIN", 1, 2, 3, 4), **outputs("HIL_ACT", 1, 2, 3, 4)}
    assert layout_from_parameters(both).outputs == (1, 2, 3, 4)
    split = layout_from_parameters({**rotors(*QUAD_X), **outputs("PWM_MAIN", 1, 2), **outputs("PWM_AUX", 3, 4)})
    assert (split.layout is None, split.outputs) == (False, None)
    assert "motors on PWM_AUX, PWM_MAIN" in split.reason


def told(encoder: Encoder, name: str, number: float) -> bytes:
    return encoder.encode(MessageId.PARAM_VALUE, name.encode(), number, 9, 100, 0xFFFF)


def test_a_link_carries_the_parameters_that_pass_by_before_the_vehicle_entered_and_after() -> None:
    named = {**COPTER_X, **servos(33, 34, 35, 36)}
    decoder, vehicle = LinkDecoder(datagrams=False), MadeVehicle(1, Autopilot.ARDUPILOTMEGA)
    for k in range(300):
        data = b"".join(vehicle.samples(1))
        data += b"".join(told(vehicle.encoder, *pair) for pair in named.items()) if k == 1 else b""
        received = decoder.feed(as_columns([(data, (k + 1) * 10_000_000)]), (k + 1) * 10_000_000)
    assert received[1].parameters == named
    again = decoder.feed(as_columns([(told(Encoder(1, 1), "FRAME_TYPE", 0.0), 4_000_000_000)]), 4_000_000_000)
    assert again[1].parameters == {**named, "FRAME_TYPE": 0.0}
