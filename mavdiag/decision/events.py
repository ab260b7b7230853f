"""From a statistic and its threshold to events: `step(state, reading) -> (state, opened and closed events)`.

An event is a stretch of judged rows in which the statistic is strictly above its threshold. It opens at the first
such row, so its start is the time of detection, and closes when the statistic has come back and stayed there for
`clear_s`; what happens within that time belongs to the same event.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from mavdiag.airframe.propellers import FaultType
from mavdiag.telemetry import NS_PER_S, Axis, BoolArray, FloatArray, IntArray

__all__ = ["Event", "EventSpec", "EventState", "Reading", "events", "finish", "start"]


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What a monitor says of consecutive rows. t_ns: (n,) vehicle time; statistic: (n,) in the monitor's unit;
    level: (n,) a second figure that describes the event (for the thesis rule the excess over the margin [rad/s]);
    signal: (n,) what the statistic is made of, for a display (there the residual [rad/s]);
    valid: (n,) False where nothing may be concluded. rotors: (n, R) evidence for each rotor, dimensionless, or (n, 0).
    """

    t_ns: IntArray
    statistic: FloatArray
    level: FloatArray
    signal: FloatArray
    valid: BoolArray
    rotors: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True, slots=True)
class EventSpec:
    """Whose events these are, and when one opens and closes."""

    monitor: str
    axis: Axis | None
    threshold: float
    clear_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Event:
    """One alarm of one monitor. Times are of the vehicle's clock; end_ns is None while it lasts.

    statistic, level: the highest so far; judge them against `threshold`, which has the statistic's unit. rotor (from
    1), fault_type, severity (1..3), confidence of the rotor (0..1): as far as the diagnosis knew at the event's end.
    """

    monitor: str
    axis: Axis | None
    start_ns: int
    end_ns: int | None
    statistic: float
    threshold: float
    level: float
    rotor: int | None = None
    fault_type: FaultType | None = None
    severity: int | None = None
    confidence: float | None = None


@dataclass(frozen=True, slots=True)
class EventState:
    """The event that is open, if any, and the last row that was above the threshold."""

    open: Event | None = None
    above_ns: int = 0
    touching: bool = False  # that row was the last one seen


def start() -> EventState:
    """No event is open."""
    return EventState()


def events(spec: EventSpec, state: EventState, reading: Reading) -> tuple[EventState, tuple[Event, ...]]:
    """Take the next rows; return the events that opened (end_ns None) or closed, in order of time.

    >>> spec = EventSpec("latency", Axis.ROLL, threshold=2.0)
    >>> t, x = np.arange(5) * 1000, np.array([0.0, 3.0, 4.0, 1.0, 1.0])
    >>> state, seen = events(spec, start(), Reading(t, x, x, x, np.ones(5, dtype=bool)))
    >>> [(e.start_ns, e.end_ns, e.statistic) for e in seen]
    [(1000, None, 3.0), (1000, 2000, 4.0)]
    """
    if len(reading.t_ns) == 0:
        return state, ()
    above = reading.valid & (reading.statistic > spec.threshold)
    seen: list[Event] = []
    edges = np.flatnonzero(np.diff(above, prepend=False, append=False)) if above.any() else np.empty(0, dtype=np.intp)
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if first or not state.touching:
            state, closed = _close(spec, state, int(reading.t_ns[first]))
            seen += closed
        if state.open is None:
            opened = _event(spec, reading, first)
            seen.append(opened)
            state = EventState(opened)
        state = _grow(state, reading, first, stop)
    if state.open is not None:
        state = EventState(state.open, state.above_ns, bool(above[-1]))
        if not state.touching:
            state, closed = _close(spec, state, int(reading.t_ns[-1]))
            seen += closed
    return state, tuple(seen)


def finish(state: EventState) -> tuple[Event, ...]:
    """The event that is still open at the end of a log, with its highest figures; its end was not seen."""
    return () if state.open is None else (state.open,)


def _event(spec: EventSpec, reading: Reading, row: int) -> Event:
    statistic, level = float(reading.statistic[row]), float(reading.level[row])
    return Event(spec.monitor, spec.axis, int(reading.t_ns[row]), None, statistic, spec.threshold, level)


def _grow(state: EventState, reading: Reading, first: int, stop: int) -> EventState:
    if state.open is None:
        return state
    grown = replace(
        state.open,
        statistic=max(state.open.statistic, float(reading.statistic[first:stop].max())),
        level=max(state.open.level, float(reading.level[first:stop].max())),
    )
    return EventState(grown, int(reading.t_ns[stop - 1]))


def _close(spec: EventSpec, state: EventState, now_ns: int) -> tuple[EventState, tuple[Event, ...]]:
    """Close the open event if the statistic has been back for `clear_s` at `now_ns`."""
    if state.open is None or now_ns - state.above_ns < spec.clear_s * NS_PER_S:
        return state, ()
    return EventState(), (replace(state.open, end_ns=state.above_ns),)
