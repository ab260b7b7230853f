"""A model survives its record, and says what is not known."""

import dataclasses
import json
import math

import numpy as np
import pytest
from identification_data import WELL, record
from numpy.testing import assert_array_equal
from pydantic import TypeAdapter

from mavdiag.errors import IdentificationError
from mavdiag.identify import Method, ModelRecord, fit


def test_the_record_of_a_model_gives_the_model_back_also_through_json() -> None:
    train = record(WELL, 1500, 0.1, 0)
    model = fit(train.u, train.y, dt=0.01)
    stored = json.dumps(dataclasses.asdict(ModelRecord.of(model)), allow_nan=False)
    back = TypeAdapter(ModelRecord).validate_json(stored).model()
    for name in ("a", "b", "standard_errors", "covariance"):
        assert_array_equal(getattr(back, name), getattr(model, name))
    assert (back.r2t, back.mse, back.samples, back.order) == (model.r2t, model.mse, 1500, (2, 2, 1))
    assert np.all(np.linalg.eigvalsh(model.covariance) > 0)


def test_what_is_not_known_is_none_and_empty() -> None:
    stored = ModelRecord.of(WELL)
    assert (stored.r2t, stored.standard_errors, stored.covariance) == (None, (), ())
    assert math.isnan(stored.model().r2t)
    assert np.isnan(stored.model().standard_errors).all()


def test_numbers_that_are_no_model_are_refused() -> None:
    with pytest.raises(IdentificationError, match="a\\[0\\] = 1"):
        ModelRecord(a=(2.0, 0.0), b=(1.0,), dt_s=0.01, order=(1, 1, 0), method=Method.SRIV)
