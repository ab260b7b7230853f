"""The thesis's printed models: exact poles and gains, which is all that can be checked about them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mavdiag.identify import Method
from mavdiag.identify.lab.published import THESIS_PITCH, THESIS_ROLL, ReferenceModel
from mavdiag.telemetry import Axis


@pytest.mark.parametrize(
    ("reference", "poles", "gain", "scale"),
    [(THESIS_ROLL, (0.9985, 0.5341), 194.14, 1 / 75), (THESIS_PITCH, (0.9908, 0.9455), 317.40, 1 / 298)],
)
def test_poles_and_gain(reference: ReferenceModel, poles: tuple[float, float], gain: float, scale: float) -> None:
    assert_allclose(reference.model.poles.real, poles, atol=5e-5)
    assert_allclose(reference.model.poles.imag, 0.0)
    assert reference.model.dc_gain == pytest.approx(gain, abs=0.005)
    assert reference.input_scale == scale
    assert reference.model.method is Method.PUBLISHED
    assert np.all(np.isnan(reference.model.standard_errors))
    assert np.isnan(reference.model.r2t)


def test_coefficients_as_printed() -> None:
    assert_allclose(THESIS_ROLL.model.b, [0.0, 0.0743, 0.0616])
    assert_allclose(THESIS_ROLL.model.a, [1.0, -1.5326, 0.5333])
    assert_allclose(THESIS_PITCH.model.b, [0.0, 0.1014, 0.0573])
    assert_allclose(THESIS_PITCH.model.a, [1.0, -1.9363, 0.9368])
    assert (THESIS_ROLL.axis, THESIS_PITCH.axis) == (Axis.ROLL, Axis.PITCH)


def test_the_scale_acts_on_the_input() -> None:
    u = np.random.default_rng(1).standard_normal(100)
    assert_allclose(THESIS_ROLL.scaled.simulate(u) * 75, THESIS_ROLL.model.simulate(u), rtol=1e-9)
