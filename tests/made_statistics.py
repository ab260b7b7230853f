"""Statistics from plain arrays, and events and changes compared."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from mavdiag.decision.alarm import Change, Event
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S


def statistic(
    value: FloatArray, *, first_s: float = 0.0, dt_s: float = 0.02, rotors: tuple[float, ...] = ()
) -> Statistic:
    """A value every `dt_s`; those that are not finite are not valid. rotors: evidence in every row."""
    t_ns = np.round((first_s + dt_s * np.arange(len(value))) * NS_PER_S).astype(np.int64)
    known = np.isfinite(value)
    told = np.where(known, value, 0.0)
    evidence = np.tile(rotors, (len(value), 1)) if rotors else np.empty((0, 0))
    return Statistic(t_ns, dt_s, told, known, told, told, evidence)


def assert_alike(found: Sequence[Event | Change], expected: Sequence[Event | Change]) -> None:
    """Equal in all fields and in order, but for the rounding of running sums."""
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for field in dataclasses.fields(one):
            a, b = getattr(one, field.name), getattr(other, field.name)
            assert a == (pytest.approx(b, rel=1e-9, nan_ok=True) if isinstance(b, float) else b), field.name
