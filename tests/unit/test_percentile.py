"""The percentile of the margins: numpy's Hazen definition is the prctile of MATLAB and Octave."""

import json

import numpy as np
from numpy.testing import assert_allclose
from shared_data import shared


def test_hazen_is_the_prctile_of_octave() -> None:
    folder = shared("reference/octave")
    x = np.loadtxt(folder / "sg_input.csv")
    reference = json.loads((folder / "prctile_reference.json").read_text())
    ours = np.percentile(x, reference["p"], method="hazen")
    assert_allclose(ours, reference["method5_default"], rtol=1e-13, atol=1e-13)
