"""Vibration: the unbalance that shakes, the level that an autopilot tells, the high-pass; and ISO 1940-1."""

import math
from dataclasses import replace

import numpy as np
import pytest
from made_rows import calibrated, example_context, example_rows, read
from scipy.signal import firwin, freqz

from mavdiag.airframe.balance import Grade, assess_unbalance, grade_named, permissible_unbalance_g_mm, unbalance_g_mm
from mavdiag.airframe.layout import layout_named, layout_of_effects
from mavdiag.airframe.propellers import PROPELLERS, DamagedPropeller
from mavdiag.errors import InputError, UsageError
from mavdiag.monitors.base import Flights
from mavdiag.monitors.unbalance import Unbalance, UnbalanceSpec, corner_of
from mavdiag.monitors.vibration_level import VibrationLevel, VibrationLevelSpec
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import highpass
from mavdiag.telemetry import FloatArray

MASS, HOVER = 1.504, 1047.2
N = 3000
T = np.arange(N) * 0.001
ROTOR_G, SPEED_RPM = 30.0, 10_000.0  # T 3.2.2
HEALTHY_MASS_G = 7.198  # T Table 3.2, two of three; the third weighs 7.197 g


def fit(
    flights: Flights, frame: str | None = None, hover: tuple[float, float] | None = None, dt_s: float = 0.001
) -> UnbalanceSpec:
    mass_kg, hover_rad_s = hover or (None, None)
    (spec,) = Unbalance.fit(flights, example_context(frame, dt_s, mass_kg=mass_kg, hover_rad_s=hover_rad_s))
    return spec


def noise(seed: int) -> tuple[FloatArray, FloatArray]:
    """Accelerometer and gyro of a balanced vehicle in hover."""
    rng = np.random.default_rng(seed)
    return rng.normal((0, 0, -9.81), 0.05, (N, 3)), rng.normal(0, 0.002, (N, 3))


def shaken(rotor: int, unbalance_g_mm: float, *, speed: float = HOVER, gyro_delay_s: float = 0.0) -> Rows:
    """A flight with one unbalanced rotor: a force U w^2 that turns, and the yaw that it makes by its arm.

    f = U w^2 (cos wt, s sin wt),  Izz dr/dt = x f_y - y f_x, at hub (x, y) and sense s (+1 clockwise from above).
    """
    force, gyro = noise(rotor)
    roll, pitch, yaw = layout_named("qdrone2").signs[rotor - 1]
    x, y, s = 0.1016 * pitch, -0.127 * roll, -yaw
    pull = 1e-6 * unbalance_g_mm * speed**2
    force[:, 0] += pull / MASS * np.cos(speed * T)
    force[:, 1] += pull / MASS * s * np.sin(speed * T)
    late = T - gyro_delay_s
    gyro[:, 2] += pull / (0.0182 * speed) * (-x * s * np.cos(speed * late) - y * np.sin(speed * late))
    return example_rows(N, 0.001, force=force, rate=gyro)


@pytest.fixture(scope="module")
def spec() -> UnbalanceSpec:
    force, gyro = noise(99)
    return fit([[example_rows(N, 0.001, force=force, rate=gyro)]], "qdrone2", (MASS, HOVER))


@pytest.mark.parametrize("unbalance", [0.5, 1.4, 5.52])
def test_the_figure_is_the_unbalance_that_shakes(spec: UnbalanceSpec, unbalance: float) -> None:
    found = read(Unbalance(spec), shaken(1, unbalance))
    np.testing.assert_allclose(found.level[found.valid], unbalance, rtol=0.03)


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
@pytest.mark.parametrize("delay_s", [-0.001, 0.0, 0.001])
def test_the_rotor_is_named_with_sensors_a_millisecond_apart(spec: UnbalanceSpec, rotor: int, delay_s: float) -> None:
    found = read(Unbalance(spec), shaken(rotor, 1.4, gyro_delay_s=delay_s))
    evidence = found.rotors[found.valid]
    assert (evidence.argmax(axis=1) + 1 == rotor).all()
    first, second = np.sort(evidence, axis=1)[:, [-1, -2]].T
    assert float((first - second).min()) > (0.35 if delay_s else 0.9)


def test_a_rotor_in_the_middle_is_never_named(spec: UnbalanceSpec) -> None:
    five = layout_of_effects("five", [*layout_named("qdrone2").signs, (0.0, 0.0, 1.0)])
    found = read(Unbalance(replace(spec, layout=five)), shaken(2, 1.4))
    assert (found.rotors[found.valid].argmax(axis=1) == 1).all()


@pytest.mark.parametrize(
    ("rate_hz", "corner_hz", "rotor_hz", "word"),
    [
        (1000.0, None, None, None),
        (100.0, 20.0, None, "low-passed at 20 Hz"),  # ArduPilot's RAW_IMU
        (50.0, None, None, "comes at 50 Hz"),
        (160.0, None, 167.0, "fold to 7 Hz"),  # PX4's HIGHRES_IMU
        (250.0, None, 167.0, None),  # folds to 83 Hz
        (1000.0, 40.0, 50.0, "low-passed at 40 Hz"),  # a large propeller's line
        (250.0, None, 24.0, "24 Hz are 24 Hz, among"),
        (200.0, None, 167.0, None),  # folds to 33 Hz, above what a flight moves
        (400.0, None, 395.0, "fold to 5 Hz"),
    ],
)
def test_a_link_that_cannot_carry_it_is_refused_with_a_reason(
    rate_hz: float, corner_hz: float | None, rotor_hz: float | None, word: str | None
) -> None:
    hover_rad_s = None if rotor_hz is None else 2 * math.pi * rotor_hz
    if word is None:
        assert 0 < corner_of(rate_hz, corner_hz, hover_rad_s) <= 60.0
    else:
        with pytest.raises(InputError, match=word):
            corner_of(rate_hz, corner_hz, hover_rad_s)


def test_b12_the_high_pass_leaves_the_line_of_a_slow_rotor() -> None:
    """B12: the corner was 60 Hz whatever the rotor, and took out the line of one that turns at 50 Hz."""
    hover, (force, gyro), unbalance_g_mm = 2 * math.pi * 50.0, noise(10), 100.0
    spec = fit([[example_rows(N, 0.001, force=force, rate=gyro)]], "qdrone2", (10.0, hover))
    assert spec.corner_hz == pytest.approx(0.36 * 50.0)
    old, flight = Unbalance(replace(spec, corner_hz=250.0)), [example_rows(N, 0.001, force=force, rate=gyro)]
    assert old.renewed([flight], example_context())[1] == pytest.approx(0.5**0.5, rel=0.05)  # what its filter lets by
    pull = 1e-6 * unbalance_g_mm * hover**2 / 10.0
    force[:, :2] += pull * np.column_stack((np.cos(hover * T), np.sin(hover * T)))
    force[:, 0] += 1.0 * np.sin(2 * np.pi * 2 * T)  # the flight's own motion
    found = read(Unbalance(spec), example_rows(N, 0.001, force=force, rate=gyro))
    np.testing.assert_allclose(found.level[found.valid], unbalance_g_mm, rtol=0.05)


def test_the_statistic_is_the_mean_norm_of_five_seconds() -> None:
    vibration = np.abs(np.random.default_rng(1).normal(1.0, 0.3, (1500, 3)))
    found = read(VibrationLevel(VibrationLevelSpec(healthy=1.0)), example_rows(1500, vibration=vibration))
    expected = [np.linalg.norm(vibration[i - 499 : i + 1], axis=1).mean() for i in range(499, 1500)]
    np.testing.assert_allclose(found.value[found.valid], expected, rtol=1e-12)
    np.testing.assert_allclose(found.level, found.value - 1.0)
    assert int(found.valid.sum()) == 1001


def test_a_still_vehicle_gets_room_of_some_half_a_metre_per_second_squared() -> None:
    flights = [[example_rows(3000, segment=i, vibration=np.full((3000, 3), 0.01))] for i in range(3)]
    monitor, threshold = calibrated(VibrationLevel, flights, example_context())
    assert monitor.spec.healthy == pytest.approx(0.01 * np.sqrt(3))
    assert 0.3 < threshold.value - monitor.spec.healthy < 0.8


@pytest.mark.parametrize(("corner", "taps"), [(0.06, 61), (0.15, 25), (0.25, 15)])
def test_the_high_pass_answers_as_one_by_scipy_or_is_refused(corner: float, taps: int) -> None:
    peer = firwin(taps, 2 * corner, window=("kaiser", 4.0), pass_zero=False)
    ours = highpass(corner, taps)
    for f in np.linspace(0, np.pi, 40):
        gains = [abs(freqz(h, worN=[f])[1][0]) for h in (ours, peer)]
        assert gains[0] == pytest.approx(gains[1], abs=0.02)
    assert ours.sum() == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(ours, ours[::-1])
    for wrong in ((corner, taps - 1), (corner, 1), (0.0, taps), (0.5, taps)):
        with pytest.raises(UsageError):
            highpass(*wrong)


def test_the_worked_example_of_the_thesis() -> None:
    report = assess_unbalance(0.22, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert report.permissible_um == pytest.approx(6.0, abs=0.05)
    assert permissible_unbalance_g_mm(Grade.G6_3, SPEED_RPM, ROTOR_G) == pytest.approx(0.18, abs=0.001)
    slow = assess_unbalance(1.0, rotor_mass_g=ROTOR_G, speed_rpm=1.0, grade=Grade.G1)
    assert round(slow.permissible_um) == 9549  # and not 9594


def test_the_grades_of_the_standard() -> None:
    assert [grade.mm_s for grade in Grade] == [4000, 1600, 630, 250, 100, 40, 16, 6.3, 2.5, 1, 0.4]
    assert [grade_named(str(grade).lower()) for grade in Grade] == list(Grade)
    for text in ("", "G", "G7", "best", "-6.3", "nan"):
        with pytest.raises(UsageError, match=r"G4000, .* G0\.4"):
            grade_named(text)


def test_a_report_says_what_was_asked_and_what_is_met() -> None:
    report = assess_unbalance(unbalance_g_mm(0.085, 60.0), rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert (report.within, report.grade, report.met) == (False, Grade.G6_3, Grade.G250)
    assert report.ratio == pytest.approx(5.1 / 0.18048, rel=1e-4)
    assert report.specific_um == pytest.approx(170.0)
    assert report.level_mm_s == pytest.approx(178.02, abs=0.01)
    assert report.force_n == pytest.approx(0.085e-3 * 0.060 * (SPEED_RPM * math.pi / 30) ** 2)
    assert report.sentence == "5.1 g mm exceeds G6.3: 28.26 x the permissible 0.18 g mm, meets G250"
    huge = assess_unbalance(1e6, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert (huge.met, huge.sentence.endswith("beyond G4000")) == (None, True)
    assert assess_unbalance(0.0, rotor_mass_g=1.0, speed_rpm=1.0).met is Grade.G0_4


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_nonsense_is_refused_by_name(bad: float) -> None:
    for call, words in (
        (lambda: unbalance_g_mm(bad, 1.0), "mass must be"),
        (lambda: unbalance_g_mm(1.0, bad), "radius must be"),
        (lambda: assess_unbalance(bad, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM), "unbalance must be"),
        (lambda: assess_unbalance(1.0, rotor_mass_g=bad, speed_rpm=1.0), "rotor mass must be"),
        (lambda: assess_unbalance(1.0, rotor_mass_g=30.0, speed_rpm=bad), "speed must be"),
        (lambda: assess_unbalance(1e300, rotor_mass_g=1e-300, speed_rpm=1.0), "units"),
    ):
        with pytest.raises(UsageError, match=words):
            call()


@pytest.mark.parametrize("found", PROPELLERS, ids=[row.code for row in PROPELLERS])
def test_table_3_2_recomputed(found: DamagedPropeller) -> None:
    assert found.mass_g + found.lost_g == pytest.approx(HEALTHY_MASS_G, abs=1e-9)
    # The split masses are rounded to a milligram.
    assert len(found.radii_mm) * found.each_g == pytest.approx(found.lost_g, abs=0.00101)
    if found.code == "F2/SV3":
        assert (round(found.unbalance_g_mm, 3), found.printed_g_mm) == (2.970, 2.640)
    else:
        assert found.unbalance_g_mm == pytest.approx(found.printed_g_mm, abs=1e-9)
