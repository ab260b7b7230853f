"""Rows from plain arrays: for the examples in the docstrings, and for tests."""

from dataclasses import fields
from typing import Any

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext
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
        **dict.fromkeys(("thrust", "height", "voltage"), narrow),
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


def example_context(
    frame: str | None = None, dt_s: float = 0.01, *, mass_kg: float | None = None, hover_rad_s: float | None = None
) -> LearnContext:
    """What fits need beside such rows. frame: name of the rotor layout, if it is known."""
    layout = None if frame is None else layout_named(frame)
    airframe = Airframe(layout=layout, mass_kg=mass_kg, hover_rad_s=hover_rad_s)
    return LearnContext(airframe, None, dt_s, WINDOW)


def rows_between(rows: Rows, first: int, stop: int) -> Rows:
    """Rows [first, stop), with the rates that they complete."""
    rates, lag = rows.rates, len(rows.block) - len(rows.rates)
    kept = slice(max(first - lag, 0), max(stop - lag, 0))
    columns = (getattr(rates, column.name)[kept] for column in fields(rates)[2:])
    return Rows(rows.block.rows(first, stop), type(rates)(rates.segment, rates.dt_s, *columns))
