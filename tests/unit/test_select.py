"""Sweeps over orders and windows choose what made the data."""

import numpy as np
import pytest
from identification_data import WELL, record

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method
from mavdiag.identify.lab.sweep import ORDERS, best_row, sweep


@pytest.mark.parametrize("seed", range(2))
def test_the_order_that_made_the_data_is_chosen(seed: int) -> None:
    train, other = record(WELL, 1500, 0.1, seed), record(WELL, 1000, 0.1, seed + 100)
    rows = sweep(((one, 0, (train.u, train.y), (other.u, other.y)) for one in ORDERS), dt=0.01)
    assert len(rows) == 3 * 5 * 5
    assert len({row.order for row in rows}) == 75
    assert best_row(rows).order == (2, 2, 1)


def test_orders_that_cannot_be_identified_carry_their_reason() -> None:
    rng = np.random.default_rng(4)
    grows = ArxModel(np.array([1.0, -1.02]), np.array([0.0, 1.0]), 0.01, (1, 1, 1), Method.PUBLISHED)
    u = rng.standard_normal(300)
    flights = u, grows.simulate(u)
    rows = sweep(((one, 0, flights, None) for one in ((1, 1, 1), (1, 2, 1))), dt=0.01, method="ls")
    assert [row.model for row in rows] == [None, None]
    assert "unstable" in rows[0].refused
    assert rows[0].score == -np.inf
    with pytest.raises(IdentificationError, match="no candidate"):
        best_row(rows)
