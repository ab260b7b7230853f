"""From a judged flight to what the history keeps of it. Pure: nothing is judged here, and nothing is stored."""

import numpy as np

from mavdiag.baseline import Baseline
from mavdiag.history.records import FlightRecord, SlotFigures
from mavdiag.judging import JudgedFlight
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.telemetry import Log
from mavdiag.traces import SlotTrace, slot_traces

__all__ = ["content_of", "record_of"]


def record_of(log: Log, judged: JudgedFlight, baseline: Baseline, *, airframe: str, added_ns: int) -> FlightRecord:
    """What is kept of a flight. added_ns: the present time, unix epoch [ns]."""
    traces = slot_traces(judged.chain, judged.pieces) if judged.chain is not None else ()
    verdict = judged.verdict
    return FlightRecord(
        airframe=airframe,
        log=log.name,
        content=content_of(log),
        started_ns=log.started_ns,
        added_ns=added_ns,
        baseline=baseline.digest,
        verdict=verdict.verdict,
        reason=verdict.reason,
        judged_s=verdict.judged_s,
        slots=tuple(_figures(one) for one in traces),
        rotor_trim=_rotor_trim(traces),
    )


def content_of(log: Log) -> str:
    """What a flight is known by, whether its vehicle was named or not: the hash of its file, and the vehicle in it."""
    return log.sha256 if log.vehicle is None else f"{log.sha256}:{log.vehicle}"


def _figures(trace: SlotTrace) -> SlotFigures:
    slot, found = trace.slot, trace.found
    value = found.value[found.valid]
    value = value[np.isfinite(value)]
    name, axis = slot.key
    median, peak = (float(np.median(value)), float(value.max())) if len(value) else (None, None)
    return SlotFigures(name, axis, slot.monitor.unit, slot.threshold, median, peak, found.judged_s)


def _rotor_trim(traces: tuple[SlotTrace, ...]) -> tuple[float, ...]:
    """The rises of the rotors, medians over the flight."""
    for found in (one.found for one in traces if isinstance(one.slot.monitor, RotorTrim)):
        if found.rotors.shape[1] and found.valid.any():
            return tuple(np.median(found.rotors[found.valid], axis=0).tolist())
    return ()
