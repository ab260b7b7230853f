"""Savitzky-Golay filters against polynomials, scipy and Octave."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_data import shared

from mavdiag.errors import UsageError
from mavdiag.rows.savgol import SavgolFilter, coefficients, window_samples
from mavdiag.telemetry import FloatArray


def smooth(x: FloatArray, window: int) -> FloatArray:
    return SavgolFilter.smoother(window).batch(x)


def derivative(x: FloatArray, dt_s: float, window: int) -> FloatArray:
    return SavgolFilter.differentiator(window, dt_s).batch(x)


@pytest.mark.parametrize(("window", "order"), [(5, 2), (11, 2), (25, 3), (101, 2), (101, 4), (401, 2)])
def test_coefficients_equal_scipy(window: int, order: int) -> None:
    from scipy.signal import savgol_coeffs

    C = coefficients(window, order)
    assert_allclose(C[0], savgol_coeffs(window, order, use="dot"), atol=1e-14)
    assert_allclose(C[1], savgol_coeffs(window, order, deriv=1, use="dot"), atol=1e-14)
    assert_allclose(2 * C[2], savgol_coeffs(window, order, deriv=2, use="dot"), atol=1e-14)


def test_octave_reference_on_every_row() -> None:
    folder = shared("reference/octave")
    x = np.loadtxt(folder / "sg_input.csv")
    reference = np.loadtxt(folder / "sg_output_w101_o2.csv", delimiter=",")
    dt_s, window, m = 0.001, 101, 50
    ours = np.column_stack([smooth(x, window), derivative(x, dt_s, window)])
    assert_allclose(ours, reference[m:-m], rtol=1e-9, atol=1e-9)
    # Octave fills both ends from the polynomial of the first and of the last whole window. The product leaves them
    # out; here they check the complete coefficient matrix.
    offsets = np.arange(-m, m + 1)
    for rows, ends in ((slice(0, window), slice(0, m)), (slice(-window, None), slice(-m, None))):
        a0, a1, a2 = coefficients(window) @ x[rows]
        value, slope = a0 + a1 * offsets + a2 * offsets**2, (a1 + 2 * a2 * offsets) / dt_s
        assert_allclose(np.column_stack([value, slope])[ends], reference[ends], rtol=1e-9, atol=1e-9)


def test_nan_spoils_only_its_own_windows() -> None:
    x = np.sin(np.outer(np.arange(100.0), [1.0, 2.0]))
    holed = x.copy()
    holed[40, 1] = np.nan
    clean, spoiled = smooth(x, 11), smooth(holed, 11)
    hit = np.isnan(spoiled)
    assert hit.sum() == 11
    assert_allclose(spoiled[~hit], clean[~hit], rtol=0)
    assert smooth(x[:10], 11).shape == (0, 2)


@pytest.mark.parametrize(
    ("dt_s", "window_s", "expected"),
    [(0.001, 0.1, 101), (1 / 999, 0.1, 101), (1 / 1002, 0.1, 101), (1 / 270, 0.1, 27), (0.005, 0.1, 21), (0.1, 0.1, 5)],
)
def test_window_samples(dt_s: float, window_s: float, expected: int) -> None:
    assert window_samples(dt_s, window_s) == expected


def test_impossible_arguments_are_refused() -> None:
    for window, order in ((100, 2), (3, 3), (5, -1), (-5, 2)):
        with pytest.raises(UsageError, match="odd"):
            coefficients(window, order)
    for dt_s, window_s in ((0.0, 0.1), (-0.01, 0.1), (float("nan"), 0.1), (0.01, 0.0)):
        with pytest.raises(UsageError, match="positive"):
            window_samples(dt_s, window_s)
    with pytest.raises(UsageError, match="derivative"):
        SavgolFilter.differentiator(11, 0.0)
    with pytest.raises(UsageError, match="odd length"):
        SavgolFilter(np.ones(4))
