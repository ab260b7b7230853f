"""Rotor layouts: what physics says of their signs, and finding them from a flight."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.layout import LAYOUTS, RotorLayout, layout_named
from mavdiag.rows.block import Block
from mavdiag.telemetry import FloatArray
from mavdiag.testing import example_rows

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
    return replace(block, rate_setpoint=wanted) if driver == "rate error" else block


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
        assert detect_layout([replace(flight, actuator=wide)]).layout is layout_named("x")
    before = replace(flight.rows(0, 300), actuator=np.empty((300, 0)))
    assert detect_layout([before, flight.rows(300, len(flight))]).layout is layout_named("x")
    outputs, torque = flight.actuator.copy(), flight.torque.copy()
    outputs[200:400], torque[900:1100] = math.nan, math.nan
    assert detect_layout([replace(flight, actuator=outputs, torque=torque)]).layout is layout_named("x")


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
    five = replace(reversed_signs, actuator=reversed_signs.actuator[:, [0, 1, 2, 3, 0]])
    shifted = replace(other_spins, actuator=np.hstack([np.zeros((2000, 4)), other_spins.actuator]))
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
