"""Sweeps over orders and windows choose what made the data."""

import numpy as np
import pytest
from identification_data import WELL, record

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method
from mavdiag.identify.arx import Records
from mavdiag.identify.lab.sweep import best_row, order_sweep, window_sweep
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import FloatArray


@pytest.mark.parametrize("seed", range(2))
def test_the_order_that_made_the_data_is_chosen(seed: int) -> None:
    train, other = record(WELL, 1500, 0.1, seed), record(WELL, 1000, 0.1, seed + 100)
    rows = order_sweep((train.u, train.y), (other.u, other.y), dt=0.01)
    assert len(rows) == 3 * 5 * 5
    assert len({row.order for row in rows}) == 75
    assert best_row(rows).order == (2, 2, 1)


def test_orders_that_cannot_be_identified_carry_their_reason() -> None:
    rng = np.random.default_rng(4)
    grows = ArxModel(np.array([1.0, -1.02]), np.array([0.0, 1.0]), 0.01, (1, 1, 1), Method.PUBLISHED)
    u = rng.standard_normal(300)
    rows = order_sweep((u, grows.simulate(u)), dt=0.01, method="ls", orders=[(1, 1, 1), (1, 2, 1)])
    assert [row.model for row in rows] == [None, None]
    assert "unstable" in rows[0].refused
    assert rows[0].score == -np.inf
    with pytest.raises(IdentificationError, match="no candidate"):
        best_row(rows)


def test_without_validation_flights_the_training_fit_is_the_score() -> None:
    train = record(WELL, 1000, 0.1, 5)
    (row,) = order_sweep((train.u, train.y), dt=0.01, orders=[(2, 2, 1)])
    assert row.model is not None
    assert row.refused == ""
    assert row.score == row.model.r2t
    assert np.isnan(row.r2t_validation)


def test_window_sweep_has_an_optimum_for_least_squares() -> None:
    # Rough inputs through a slow system, white noise on the output: short windows leave the bias of least squares,
    # long ones flatten everything.
    slow = ArxModel(np.array([1.0, -1.9, 0.904]), np.array([0.0, 0.002, 0.002]), 0.001, (2, 2, 1), Method.PUBLISHED)
    rng = np.random.default_rng(6)
    u = np.repeat(rng.standard_normal(200), 100)
    clean = slow.simulate(u)
    y = clean + 0.3 * clean.std() * rng.standard_normal(len(u))
    other_u = np.repeat(rng.standard_normal(100), 100)
    other_y = slow.simulate(other_u)

    def filtered(u: FloatArray, y: FloatArray, window: int) -> tuple[Records, Records]:
        value = coefficients(window)[0]
        return np.correlate(u, value, "valid"), np.correlate(y, value, "valid")

    rows = window_sweep(
        lambda window: filtered(u, y, window),
        (5, 101, 801),
        dt=0.001,
        method="ls",
        prepare_validation=lambda window: filtered(other_u, other_y, window),
    )
    scores = [row.score for row in rows]
    assert [row.window for row in rows] == [5, 101, 801]
    assert scores[1] > 0.95
    assert scores[1] > scores[0] + 0.1
    assert scores[1] > scores[2]
