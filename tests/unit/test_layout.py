"""Frames: what physics says of their signs, and finding them from a flight."""

import math

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows

from mavdiag.airframe.layout import LAYOUTS, RotorLayout, detect_layout, layout_likeness, layout_named
from mavdiag.errors import UsageError
from mavdiag.monitors.base import Rows
from mavdiag.telemetry import FloatArray
from mavdiag.testing import example_rows
from sitl_plant.vehicle import allocation, qdrone2

# Where each rotor is, seen from above: (x forward, y right), and how it turns. From each vehicle's own drawing.
PLACES = {
    "qdrone2": [(-1, 1, "cw"), (1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw")],
    "crazyflie": [(1, 1, "ccw"), (-1, 1, "cw"), (-1, -1, "ccw"), (1, -1, "cw")],
    "x": [(1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw"), (-1, 1, "cw")],
    "plus": [(0, 1, "ccw"), (0, -1, "ccw"), (1, 0, "cw"), (-1, 0, "cw")],
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_signs_follow_from_where_the_rotors_are(name: str) -> None:
    mixing = layout_named(name).mixing
    for signs, (x, y, spin) in zip(mixing, PLACES[name], strict=True):
        # Thrust is up, -z in FRD: torque = (x, y, 0) x (0, 0, -1) = (-y, x, 0); the body turns against the rotor.
        assert np.sign(signs).tolist() == [-y, x, 1.0 if spin == "ccw" else -1.0]
    np.testing.assert_allclose((mixing**2).sum(axis=0), len(mixing))
    np.testing.assert_allclose(mixing.sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(layout_named(name).unmixing @ mixing, np.eye(3), atol=1e-14)


def test_the_thesis_frame_is_the_plant_s() -> None:
    assert np.array_equal(np.sign(allocation(qdrone2())[1:].T), layout_named("qdrone2").mixing)


def test_a_frame_must_command_all_three_axes() -> None:
    with pytest.raises(UsageError, match="independently"):
        RotorLayout("pair", ((1, 0, 0), (-1, 0, 0)))
    with pytest.raises(UsageError, match="no frame hexa; there are qdrone2"):
        layout_named("hexa")


def hover(frame: RotorLayout, seed: int, *, told: str, noise: float = 0.003) -> Rows:
    """20 s at 100 Hz in which the outputs drive the body and `told` says what the vehicle tells about it."""
    rng, n = np.random.default_rng(seed), 2000
    torque = np.cumsum(rng.normal(0, [0.004, 0.004, 0.001], (n, 3)), axis=0)
    torque -= np.array([np.convolve(torque[:, k], np.ones(100) / 100, "same") for k in range(3)]).T
    outputs = 0.5 * (1.0 + torque @ frame.mixing.T) + rng.normal(0, noise, (n, frame.rotors))
    delayed = np.roll(torque, 4, axis=0)  # motor lag
    rate = np.cumsum(delayed, axis=0) * 0.5
    given: FloatArray | None = torque if told == "torque" else None
    return example_rows(n, 0.01, rate=rate, actuator=outputs, torque=given)


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("told", ["torque", "nothing"])
def test_a_frame_is_found_from_a_flight(name: str, told: str) -> None:
    for seed in range(5):
        found = detect_layout([hover(layout_named(name), seed, told=told)])
        assert found is not None, f"seed {seed}"
        assert found.name == name, f"seed {seed}"


def test_frames_of_other_rotor_counts_are_data() -> None:
    angles = np.deg2rad([30, 90, 150, 210, 270, 330])
    scale = math.sqrt(2)
    hexa = RotorLayout(
        "hexa",
        tuple((-scale * math.sin(a), scale * math.cos(a), (-1.0) ** i) for i, a in enumerate(angles)),
    )
    known = (*LAYOUTS.values(), hexa)
    found = detect_layout([hover(hexa, 1, told="torque")], known)
    assert found is hexa


def test_what_stays_unclear_is_not_named() -> None:
    rng = np.random.default_rng(3)
    quiet = example_rows(2000, 0.01, actuator=np.full((2000, 4), 0.5))
    noise = example_rows(2000, 0.01, rate=rng.normal(0, 0.1, (2000, 3)), actuator=rng.normal(0.5, 0.05, (2000, 4)))
    reversed_signs = RotorLayout("x reversed", tuple((-r, -p, -y) for r, p, y in layout_named("x").signs))
    between = hover(RotorLayout("turned", tuple(_turned(s, 22.5) for s in layout_named("x").signs)), 1, told="torque")
    for rows in (quiet, noise, example_rows(2000), hover(reversed_signs, 1, told="torque"), between):
        assert detect_layout([rows]) is None
    assert detect_layout([]) is None
    assert layout_likeness([example_rows(100, actuator=np.full((100, 4), 0.5))]) is None


def _turned(signs: tuple[float, float, float], degrees: float) -> tuple[float, float, float]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return c * signs[0] - s * signs[1], s * signs[0] + c * signs[1], signs[2]


def test_the_made_flight_is_an_x() -> None:
    found = detect_layout(flying_rows(flying(2000, 7)))
    assert found is not None
    assert found.name == "x"
