"""All nine definitions of a percentile against Octave."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_data import shared

from mavdiag.errors import InputError, UsageError
from mavdiag.rows.statistics import DEFINITIONS, percentile


@pytest.mark.parametrize("method", range(1, 10))
def test_octave_reference(method: int) -> None:
    folder = shared("reference/octave")
    x = np.loadtxt(folder / "sg_input.csv")
    reference = json.loads((folder / "prctile_reference.json").read_text())
    ours = [percentile(x, q, DEFINITIONS[method - 1]) for q in reference["p"]]
    assert_allclose(ours, reference[f"method{method}" if method != 5 else "method5_default"], rtol=1e-13, atol=1e-13)


def test_the_default_is_hazen_the_prctile_of_matlab() -> None:
    folder = shared("reference/octave")
    x = np.loadtxt(folder / "sg_input.csv")
    reference = json.loads((folder / "prctile_reference.json").read_text())
    assert DEFINITIONS[4] == "hazen"
    assert_allclose([percentile(x, q) for q in reference["p"]], reference["method5_default"], rtol=1e-13, atol=1e-13)


def test_hazen_by_its_definition() -> None:
    # the i-th of n sorted values is the 100 (i - 1/2)/n percentile, linear in between, flat outside
    x = np.array([5.0, 1.0, 3.0, 2.0])
    assert [percentile(x, q) for q in (0, 12.5, 37.5, 50, 62.5, 87.5, 100)] == [1, 1, 2, 2.5, 3, 5, 5]


def test_impossible_requests_are_refused() -> None:
    with pytest.raises(InputError, match="at least one value"):
        percentile(np.empty(0), 50)
    with pytest.raises(InputError, match="NaN"):
        percentile(np.array([1.0, np.nan]), 50)
    for q in (-1.0, 100.5, float("nan")):
        with pytest.raises(UsageError, match="between 0 and 100"):
            percentile(np.ones(3), q)
    with pytest.raises(UsageError, match="not known"):
        percentile(np.ones(3), 50, "matlab")  # type: ignore[arg-type]  # a caller without a type checker
