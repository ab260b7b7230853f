"""Savitzky-Golay coefficients against scipy and Octave, and the length of a window."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import savgol_coeffs
from shared_data import shared

from mavdiag.rows.savgol import coefficients, window_samples


@pytest.mark.parametrize(("window", "order"), [(5, 2), (11, 2), (25, 3), (101, 2), (101, 4), (401, 2)])
def test_coefficients_equal_scipy(window: int, order: int) -> None:
    C = coefficients(window, order)
    for degree, factor in enumerate((1, 1, 2)):
        assert_allclose(factor * C[degree], savgol_coeffs(window, order, deriv=degree, use="dot"), atol=1e-14)


def test_octave_reference_on_every_row() -> None:
    folder = shared("reference/octave")
    x = np.loadtxt(folder / "sg_input.csv")
    reference = np.loadtxt(folder / "sg_output_w101_o2.csv", delimiter=",")
    dt_s, window, m = 0.001, 101, 50
    value, slope, _ = coefficients(window)
    ours = np.column_stack([np.correlate(x, value, "valid"), np.correlate(x, slope / dt_s, "valid")])
    assert_allclose(ours, reference[m:-m], rtol=1e-9, atol=1e-9)
    # Octave fills both ends from the polynomial of the first and of the last whole window. The product leaves them
    # out; here they check the complete coefficient matrix.
    offsets = np.arange(-m, m + 1)
    for rows, ends in ((slice(0, window), slice(0, m)), (slice(-window, None), slice(-m, None))):
        a0, a1, a2 = coefficients(window) @ x[rows]
        found = np.column_stack([a0 + a1 * offsets + a2 * offsets**2, (a1 + 2 * a2 * offsets) / dt_s])
        assert_allclose(found[ends], reference[ends], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("dt_s", "window_s", "expected"),
    [(0.001, 0.1, 101), (1 / 999, 0.1, 101), (1 / 1002, 0.1, 101), (1 / 270, 0.1, 27), (0.005, 0.1, 21), (0.1, 0.1, 5)],
)
def test_window_samples(dt_s: float, window_s: float, expected: int) -> None:
    assert window_samples(dt_s, window_s) == expected
