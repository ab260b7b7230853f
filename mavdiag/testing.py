"""Rows from plain arrays: for the examples in the docstrings, and for tests."""

from typing import Any

import numpy as np

from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import BoolArray, FloatArray

WINDOW = 5  # samples of the rate filters


def example_rows(
    n: int,
    dt_s: float = 0.01,
    *,
    segment: int = 0,
    setpoint: FloatArray | None = None,
    rate: FloatArray | None = None,
    **columns: FloatArray | BoolArray | None,
) -> Rows:
    """n rows of one segment with the columns of `Block` given, (n, k) each; other signals are absent.

    The set-point is at rest if not given; the gyro turns the nose as it commands. Rate filters of 5 samples.
    """
    wide, narrow, always = np.full((n, 3), np.nan), np.full(n, np.nan), np.ones(n, dtype=np.bool_)
    turning = np.zeros((n, 3))
    if setpoint is not None and n > 1:
        turning[:, 2] = np.gradient(setpoint[:, 2], dt_s)
    made: dict[str, Any] = {
        "setpoint": np.zeros((n, 3)) if setpoint is None else setpoint,
        "rate": turning if rate is None else rate,
        **dict.fromkeys(("force", "torque", "rate_setpoint", "attitude", "vibration"), wide),
        **dict.fromkeys(("thrust", "height"), narrow),
        "armed": np.ones(n),
        **dict.fromkeys(("actuator", "rotor_speed"), np.empty((n, 0))),
        "doubt": np.zeros(n),
        **dict.fromkeys(("valid", "setpoint_valid"), always),
        **{name: column for name, column in columns.items() if column is not None},
    }
    t_ns = round(segment * 1e12) + np.round(np.arange(n) * dt_s * 1e9).astype(np.int64)
    block = Block(segment=segment, dt_s=dt_s, t_ns=t_ns, **made)
    spec = RateSpec.of(dt_s, WINDOW)
    return Rows(block, spec.step(spec.start(), block))
