"""Statistics and slots from plain values; what the kernel makes of statistics, the slow way; events compared."""

import dataclasses
import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mavdiag.decision.alarm import DecisionSpec, DecisionState, height_of
from mavdiag.decision.diagnosis import Change, Event
from mavdiag.kernel import (
    AT,
    EVIDENCE,
    HIGHEST,
    JUDGED,
    LAST,
    LAST_LEVEL,
    LOOK_NS,
    NEVER,
    READ_ROTORS,
    SQUARES,
    STALE_LOOKS,
    Alarm,
    Looked,
    Slot,
)
from mavdiag.monitors.base import FaultKind, RotorEvidence
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_S

SUSPECTED = 0.8  # of the threshold, where a slot that decides raises a suspicion


def made_slot(
    name: str, threshold: float, decides: bool = True, evidence: RotorEvidence | None = None, **of_monitor: Any
) -> Slot:
    """A slot of a monitor with these attributes and no loop."""
    usual = {"axis": None, "unit": "", "kind": FaultKind.PROPELLER, "feature": None, "rotors": 4}
    monitor = SimpleNamespace(name=name, **{**usual, "delay_s": 0.0, "clear_s": 2.0, "memory_s": 5.0, **of_monitor})
    return Slot(cast(Any, monitor), threshold, decides, evidence, SUSPECTED if decides else 1.0)


def statistic(
    value: FloatArray, *, first_s: float = 0.0, dt_s: float = 0.02, rotors: tuple[float, ...] = ()
) -> Statistic:
    """A value every `dt_s`; those that are not finite are not valid. rotors: evidence in every row."""
    t_ns = np.round((first_s + dt_s * np.arange(len(value))) * NS_PER_S).astype(np.int64)
    known = np.isfinite(value)
    told = np.where(known, value, 0.0)
    evidence = np.tile(rotors, (len(value), 1)) if rotors else np.empty((0, 0))
    return Statistic(t_ns, dt_s, told, known, told, told, evidence)


def alarms_of(number: int, slot: Slot, found: Statistic, looks: Sequence[int]) -> list[Alarm]:
    """What opens and closes: alarms are stretches of values above, less than `clear_s` apart. looks: that of each."""
    told, above = list[Alarm](), np.flatnonzero(found.valid & (found.value > slot.threshold)).tolist()
    clear_ns = round(slot.monitor.clear_s * NS_PER_S)
    while above:
        (first, *rest), last = above, above[0]
        for k in rest:
            if k != last + 1 and found.t_ns[k] - found.t_ns[last] >= clear_ns:
                break
            last = k
        above = [k for k in above if k > last]
        whose = (number, int(found.t_ns[first]))
        told.append(Alarm(looks[first], *whose, -1, float(found.value[first]), float(found.level[first])))
        inside = [k for k in range(first, last + 1) if found.valid[k] and found.value[k] > slot.threshold]
        highest = float(found.value[inside].max()), float(found.level[inside].max())
        later = (k for k in range(last + 1, len(found)) if found.t_ns[k] - found.t_ns[last] >= clear_ns)
        if (cleared := next(later, None)) is not None:
            told.append(Alarm(looks[cleared], *whose, int(found.t_ns[last]), *highest))
    return told


def looked_of(
    slots: Sequence[Slot], found: Sequence[Statistic], until_ns: int, arrived_ns: Sequence[IntArray] | None = None
) -> tuple[Looked, Looked]:
    """The looks that are whole at a time, and the last one, at it. arrived_ns: when the row of each value had come."""
    known_ns = [one.t_ns + round(slot.monitor.delay_s * NS_PER_S) for slot, one in zip(slots, found, strict=True)]
    if arrived_ns is not None:
        known_ns = [np.maximum(one, other) for one, other in zip(known_ns, arrived_ns, strict=True)]
    numbers = [[-(-t // LOOK_NS) for t in one.tolist()] for one in known_ns]
    first, whole = min(n[0] for n in numbers if n), until_ns // LOOK_NS
    count, width = whole - first + 2, max(slot.monitor.rotors for slot in slots)
    sums, latest = np.zeros((count, len(slots), EVIDENCE + 2 * width)), np.zeros((len(slots), READ_ROTORS + width))
    sums[:, :, HIGHEST], latest[:, AT] = np.nan, NEVER
    told = list[Alarm]()
    for number, (slot, one, looks) in enumerate(zip(slots, found, numbers, strict=True)):
        told += alarms_of(number, slot, one, looks)
        for k, look in enumerate(looks):
            record = sums[min(look - first, count - 1), number]
            ratio = float(one.value[k]) / slot.threshold if one.valid[k] else -1.0
            record[HIGHEST] = ratio if math.isnan(record[HIGHEST]) else max(record[HIGHEST], ratio)
            if one.valid[k]:
                record[[LAST, LAST_LEVEL]] = one.value[k], one.level[k]
                record[[JUDGED, SQUARES]] += 1.0, one.level[k] ** 2
                if one.rotors.size:
                    record[EVIDENCE : EVIDENCE + width] = one.rotors[k]
                    record[EVIDENCE + width :] += one.rotors[k]
    readings, heights, leads = np.empty((count, *latest.shape)), list[int](), list[int]()
    for look, records in enumerate(sums):
        at = first + look if look < count - 1 else until_ns / LOOK_NS
        for reading, record in zip(latest, records, strict=True):
            if record[HIGHEST] >= 0 and record[JUDGED]:
                reading[:] = (record[HIGHEST], record[LAST], at, *record[EVIDENCE : EVIDENCE + width])
        readings[look] = latest
        fresh = [(n, slot) for n, slot in enumerate(slots) if at - latest[n, AT] <= STALE_LOOKS]
        ranks = [(height_of(latest[n, 0], slot), slot.decides, latest[n, 0], -n) for n, slot in fresh]
        heights.append(int(max(ranks)[0]) if any(slot.decides for _, slot in fresh) else -1)
        leads.append(-max(ranks)[3] if ranks else -1)
    told.sort(key=lambda alarm: alarm.look)
    early, late = (tuple(one for one in told if (one.look <= whole) == now) for now in (True, False))
    last = Looked(whole + 1, readings[-1:], sums[-1:], (None,), (-1,), late, until_ns)
    return Looked(first, readings[:-1], sums[:-1], heights[:-1], leads[:-1], early), last


def decide(
    spec: DecisionSpec, found: Sequence[Statistic], state: DecisionState | None = None
) -> tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]:
    """What comes of values, up to the last of them; the same whether or not calm looks are passed over."""
    until_ns = max(int(one.t_ns[-1]) for one in found if len(one))
    whole, last = looked_of(spec.slots, found, until_ns)
    every = whole._replace(heights=(None,) * len(whole.heights))
    stories = []
    for looked in (whole, every):
        after, events, changes = spec.step(state or DecisionState(), looked)
        after, more, news = spec.step(after, last)
        stories.append((after, (*events, *more), (*changes, *news)))
    (found_state, *story), (again, *other) = stories
    assert repr((found_state.diagnosis, story)) == repr((again.diagnosis, other))
    return stories[0]


def assert_alike(found: Sequence[Event | Change], expected: Sequence[Event | Change]) -> None:
    """Equal in all fields and in order, but for the rounding of running sums."""
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for field in dataclasses.fields(one):
            a, b = getattr(one, field.name), getattr(other, field.name)
            assert a == (pytest.approx(b, rel=1e-9, nan_ok=True) if isinstance(b, float) else b), field.name
