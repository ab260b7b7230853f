"""The high-pass and the windows, against scipy's filter design and numpy's own sums."""

import numpy as np
import pytest
from scipy.signal import firwin, freqz

from mavdiag.errors import UsageError
from mavdiag.rows.windows import highpass


@pytest.mark.parametrize(("corner", "taps"), [(0.06, 61), (0.15, 25), (0.25, 15)])
def test_the_high_pass_answers_as_one_by_scipy(corner: float, taps: int) -> None:
    peer = firwin(taps, 2 * corner, window=("kaiser", 4.0), pass_zero=False)
    ours = highpass(corner, taps)
    for f in np.linspace(0, np.pi, 40):
        gains = [abs(freqz(h, worN=[f])[1][0]) for h in (ours, peer)]
        assert gains[0] == pytest.approx(gains[1], abs=0.02)
    assert ours.sum() == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(ours, ours[::-1])


@pytest.mark.parametrize(("corner", "taps"), [(0.06, 60), (0.06, 1), (0.0, 61), (0.5, 61)])
def test_an_impossible_high_pass_is_refused(corner: float, taps: int) -> None:
    with pytest.raises(UsageError):
        highpass(corner, taps)
