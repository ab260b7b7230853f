"""From a judged flight to the few figures that a history keeps of it. Pure."""

from dataclasses import dataclass

import numpy as np

from mavdiag.baseline import Baseline
from mavdiag.judging import JudgedFlight, Verdict
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.telemetry import Axis, Log
from mavdiag.traces import SlotTrace, slot_traces


@dataclass(frozen=True, slots=True)
class SlotFigures:
    """One monitor on one axis over a flight.

    monitor, axis: whose figures they are; axis is None where the monitor is about the whole vehicle.
    unit: of statistic and threshold.
    threshold: that the flight was judged by.
    median, peak: of the statistic where it is valid; None if it never was. The peak of `fsd` is the longest run [s].
    judged_s: time that it judged [s].
    """

    monitor: str
    axis: Axis | None
    unit: str
    threshold: float
    median: float | None
    peak: float | None
    judged_s: float


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """What is kept of a judged flight.

    airframe: the name that the history goes by. log: what the log was called when it was added.
    content: what it is known by, whether its vehicle was named or not: the hash of its file, and the vehicle in it.
    started_ns: wall-clock time of its first record, unix epoch [ns]; 0 if that is not known.
    added_ns: when it was judged [ns]; it stands for the start where that is not known.
    baseline: digest of the baseline that judged it.
    verdict, reason, judged_s: as in `LogVerdict`.
    slots: the monitors' figures.
    rotor_trim: by how much each rotor's command rose against the baseline, median over the flight [fraction of hover];
        empty where the trim was not judged.
    """

    airframe: str
    log: str
    content: str
    started_ns: int
    added_ns: int
    baseline: str
    verdict: Verdict
    reason: str
    judged_s: float
    slots: tuple[SlotFigures, ...] = ()
    rotor_trim: tuple[float, ...] = ()

    @property
    def t_ns(self) -> int:
        """When it is taken to have been flown, unix epoch [ns]."""
        return self.started_ns or self.added_ns


def record_of(
    log: Log, judged: JudgedFlight, baseline: Baseline, *, airframe: str = "", added_ns: int = 0
) -> FlightRecord:
    """What is kept of a flight. added_ns: the present time, unix epoch [ns]."""
    traces = slot_traces(judged.chain, judged.pieces) if judged.chain is not None else ()
    content = log.sha256 if log.vehicle is None else f"{log.sha256}:{log.vehicle}"
    known = (airframe, log.name, content, log.started_ns, added_ns, baseline.digest)
    told = (judged.verdict.verdict, judged.verdict.reason, judged.verdict.judged_s)
    return FlightRecord(*known, *told, tuple(_slot_figures(trace) for trace in traces), _rotor_trim(traces))


def _slot_figures(trace: SlotTrace) -> SlotFigures:
    slot, found = trace.slot, trace.found
    value = found.value[found.valid]
    value = value[np.isfinite(value)]
    median, peak = (float(np.median(value)), float(value.max())) if len(value) else (None, None)
    return SlotFigures(*slot.key, slot.monitor.unit, slot.threshold, median, peak, found.judged_s)


def _rotor_trim(traces: tuple[SlotTrace, ...]) -> tuple[float, ...]:
    for found in (trace.found for trace in traces if isinstance(trace.slot.monitor, RotorTrim)):
        if found.rotors.shape[1] and found.valid.any():
            return tuple(np.median(found.rotors[found.valid], axis=0).tolist())
    return ()
