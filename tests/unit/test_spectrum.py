"""Welch spectra against scipy and against the variance they must add up to."""

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavdiag.errors import InputError, UsageError
from mavdiag.rows.spectrum import band_power, log_band_vector, welch


@pytest.mark.parametrize(("n", "segment"), [(1000, 128), (1000, 127), (128, 128), (5000, 256), (300, 2)])
def test_scipy_agrees(n: int, segment: int) -> None:
    from scipy.signal import welch as scipy_welch

    x = np.random.default_rng(n).standard_normal((n, 2)) + 3.0
    spectrum = welch(x, 0.01, segment)
    frequency, density = scipy_welch(x, fs=100.0, nperseg=segment, noverlap=segment // 2, axis=0)
    assert_allclose(spectrum.frequency_hz, frequency, atol=1e-9)
    assert_allclose(spectrum.density, density, rtol=1e-9, atol=1e-15)
    assert_allclose(welch(x[:, 1], 0.01, segment).density, spectrum.density[:, 1], rtol=1e-12)


def test_white_noise_has_a_flat_density_that_sums_to_its_variance() -> None:
    x = 2.0 * np.random.default_rng(5).standard_normal(100_000)
    spectrum = welch(x, 0.001, 256)
    assert band_power(spectrum, (0.0, 501.0)) == pytest.approx(4.0, rel=0.02)
    inner = spectrum.density[2:-1]
    assert inner.mean() == pytest.approx(4.0 / 500.0, rel=0.02)
    assert inner.std() / inner.mean() == pytest.approx(np.sqrt(11 / 9 / spectrum.averages), rel=0.2)


def test_log_band_vector_by_columns() -> None:
    rng = np.random.default_rng(6)
    x = rng.standard_normal((20_000, 2)) * [1.0, 10.0]
    bands = ((2.0, 8.0), (8.0, 16.0), (16.0, 26.0), (26.0, 38.0), (38.0, 50.0))
    vector = log_band_vector(welch(x, 0.01), bands)
    assert vector.shape == (5, 2)
    assert_allclose(vector[:, 1] - vector[:, 0], np.log(100.0), atol=0.2)


def test_impossible_requests_are_refused() -> None:
    with pytest.raises(InputError, match="too few"):
        welch(np.zeros(100), 0.01, 128)
    for segment, dt_s in ((1, 0.01), (8, 0.0), (8, float("nan"))):
        with pytest.raises(UsageError, match="spectrum needs"):
            welch(np.zeros(100), dt_s, segment)
    spectrum = welch(np.zeros(100), 0.01, 16)
    with pytest.raises(UsageError, match="no spectral line"):
        band_power(spectrum, (1.0, 2.0))
    with pytest.raises(InputError, match="no power"):
        log_band_vector(spectrum, [(0.0, 50.0)])


def test_scipy_is_not_imported() -> None:
    code = "import sys, mavdiag.rows.spectrum, mavdiag.rows.statistics; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
