"""Rows from plain arrays: for the examples in the docstrings, and for tests."""

from dataclasses import fields

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
    actuator: FloatArray | None = None,
    torque: FloatArray | None = None,
    thrust: FloatArray | None = None,
    attitude: FloatArray | None = None,
    vibration: FloatArray | None = None,
    force: FloatArray | None = None,
    valid: BoolArray | None = None,
    setpoint_valid: BoolArray | None = None,
) -> Rows:
    """n rows of one segment with the signals given, (n, k) each, in the units of `Block`.

    The set-point is at rest if not given, other signals are absent. The gyro, if not given, turns the nose as the
    set-point commands and is at rest about the other axes. Rates by Savitzky-Golay filters of 5 samples.
    """
    absent, still, always = np.full((n, 3), np.nan), np.zeros((n, 3)), np.ones(n, dtype=np.bool_)
    turning = np.zeros((n, 3))
    if setpoint is not None and n > 1:
        turning[:, 2] = np.gradient(setpoint[:, 2], dt_s)
    block = Block(
        segment=segment,
        dt_s=dt_s,
        t_ns=round(segment * 1e12) + np.round(np.arange(n) * dt_s * 1e9).astype(np.int64),
        setpoint=still if setpoint is None else setpoint,
        rate=turning if rate is None else rate,
        force=absent if force is None else force,
        torque=absent if torque is None else torque,
        rate_setpoint=absent,
        thrust=absent[:, 0] if thrust is None else thrust,
        attitude=absent if attitude is None else attitude,
        height=absent[:, 0],
        voltage=absent[:, 0],
        armed=np.ones(n),
        vibration=absent if vibration is None else vibration,
        actuator=np.empty((n, 0)) if actuator is None else actuator,
        valid=always if valid is None else valid,
        setpoint_valid=always if setpoint_valid is None else setpoint_valid,
        doubt=np.zeros(n),
    )
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
