"""Where rows go between gyro samples with losses: every sample is one, and what is missing is filled evenly."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.rows.places import uneven_places

DT_NS = 1_000_000.0


@given(steps=st.lists(st.floats(0.6, 12.0), min_size=1, max_size=60), first_is_new=st.booleans())
def test_every_sample_is_a_row_and_gaps_are_filled_evenly(steps: list[float], first_is_new: bool) -> None:
    points = 7_000_000_000 + np.round(np.cumsum([0.0, *steps]) * DT_NS).astype(np.int64)
    rows = uneven_places(points, first_is_new, DT_NS)
    whole = rows if first_is_new else np.concatenate((points[:1], rows))
    places = np.searchsorted(whole, points)
    assert whole[places].tolist() == points.tolist()
    assert len(whole) == places[-1] + 1
    for (a, b), (i, j) in zip(itertools.pairwise(points.tolist()), itertools.pairwise(places.tolist()), strict=True):
        assert j - i == round((b - a) / DT_NS)
        np.testing.assert_allclose(whole[i : j + 1], np.linspace(a, b, j - i + 1), atol=0.51)
    # a sample within half a period of the one before changes nothing
    more = np.sort(np.concatenate((points, points + 100_000)))
    assert uneven_places(more, first_is_new, DT_NS).tolist() == rows.tolist()
