"""Rows from plain arrays: for the examples in the docstrings, and for tests."""

import numpy as np

from mavdiag.rows.block import COVERED, OUTPUTS, RATE, VALID, WHOLE, Block, Part, Rows, with_outputs
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
    x, setpoint = np.full((OUTPUTS, n), np.nan), np.zeros((n, 3)) if setpoint is None else setpoint
    x[: WHOLE + 1], x[VALID : VALID + 2], x[COVERED], x[WHOLE : RATE + 3] = 0.0, 1.0, 1.0, 0.0
    if rate is None and n > 1:
        x[RATE + 2] = np.gradient(setpoint[:, 2], dt_s)
    t_ns = round(segment * 1e12) + np.round(np.arange(n) * dt_s * 1e9).astype(np.int64)
    block = changed(Block(segment, dt_s, t_ns, x), setpoint=setpoint, rate=rate, armed=np.ones(n), **columns)
    spec = RateSpec.of(dt_s, WINDOW)
    return spec.step(spec.start(), block)


def changed(block: Block, **columns: FloatArray | BoolArray | None) -> Block:
    """The block with other columns, (n,) or (n, k); None leaves one as it is."""
    given = {name: column for name, column in columns.items() if column is not None}
    sent, speeds = given.pop("actuator", block.actuator).T, given.pop("rotor_speed", block.rotor_speed).T
    made = with_outputs(block, np.asarray(sent, np.float64), np.asarray(speeds, np.float64))
    for name, column in given.items():
        part: Part[np.float64] = Block.__dict__[name]
        made.x[part.at] = column.T
    return made
